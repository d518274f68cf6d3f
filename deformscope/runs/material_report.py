"""Results of a material, as a table and a picture."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from deformscope.experiments.fit.material_motion import MaterialEstimate, MaterialFit
from deformscope.pictures.material_figures import axes_png, field_png, recovery_png, yield_png
from deformscope.pictures.messages import reason_rows
from deformscope.pictures.report import ColoredBody, Figure, Table
from deformscope.results.render import Rows, format_value, to_rows
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.materials.axis_estimate import ACROSS_VIEW, AxisEstimate
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.recovery import RecoveryEstimate
from deformscope.stages.materials.yield_estimate import YieldEstimate


def material_table(found: MaterialEstimate, name: str) -> Table:
    """The numbers, the verdict and why to doubt it."""
    if isinstance(found, AxisEstimate):
        return Table(_axes_rows(found), caption=f"beta along the axes of {name} ({found.level:.0%} intervals)")
    if isinstance(found, FieldEstimate):
        return Table(_field_rows(found), caption=f"Stiffness of each place of {name} ({found.level:.0%} intervals)")
    if isinstance(found, YieldEstimate):
        return Table(_yield_rows(found), caption=f"Yielding of {name} ({found.level:.0%} intervals)")
    return Table(_recovery_rows(found), caption=f"Recovery of {name} ({found.level:.0%} intervals)")


def material_figure(found: MaterialFit) -> Figure:
    """The evidence."""
    estimate = found.estimate
    if isinstance(estimate, AxisEstimate):
        return Figure(axes_png(estimate), "beta along each axis")
    if isinstance(estimate, FieldEstimate):
        return Figure(field_png(estimate), "Stiffness and beta of each place, each with its interval's width")
    if isinstance(estimate, YieldEstimate):
        assert found.motion is not None
        caption = "Error over the yield strain; distance from observed to simulated in each frame"
        return Figure(yield_png(estimate, found.motion), caption)
    return Figure(recovery_png(estimate), "Indentation over time, and the recovery after the release")


def material_bodies(found: MaterialFit) -> tuple[ColoredBody, ...]:
    """Bodies of axes or a field, with the fitted particles."""
    estimate = found.estimate
    if not isinstance(estimate, AxisEstimate | FieldEstimate) or not found.comparisons:
        return ()
    seen = found.comparisons[-1][1]
    known = np.isfinite(seen.observed).all(axis=1)
    at = seen.observed[known]
    if isinstance(estimate, FieldEstimate):
        nearest = cKDTree(estimate.place).query(seen.rest[known])[1]
        return (ColoredBody("Stiffness over its geometric mean [-]", at, estimate.stiffness[nearest]),)
    share = np.linspace(-0.5, 0.5, 41)[:, None]
    lines = [at.mean(axis=0) + share * np.ptp(at @ axis) * axis for axis in estimate.axes.T]
    value = np.concatenate([np.full(len(at), np.nan), np.repeat(estimate.value, len(share))])
    return (ColoredBody("Beta along each axis [-]", np.concatenate([at, *lines]), value),)


def _axes_rows(found: AxisEstimate) -> Rows:
    rows: Rows = []
    for k, (low, high) in enumerate(found.interval):
        rows.append(
            (f"beta along {_axis(found, k)}", f"{found.value[k]:.4g} ({low:.4g} to {high:.4g}): {found.verdict[k]}")
        )
    if len(found.value) == 2:
        rows.append(("beta across the view", f"unidentified: {ACROSS_VIEW}"))
    rows += reason_rows(tuple(dict.fromkeys(one for some in found.reasons for one in some)))
    for words, most in (("pressed", found.pressed), ("bulges", found.bulges)):
        if most is None:
            rows.append((words, "along no axis"))
        else:
            rows.append((words, f"along {_axis(found, most)}: mean strain {found.strain[most]:+.3g}"))
    differ = "the axes differ" if found.anisotropic else "one beta explains the data as well"
    return [
        *rows,
        ("anisotropy", f"{differ} (one beta would leave this error with probability {found.p_isotropic:.2g})"),
        *to_rows(found, "beta"),
        ("error, axes / one beta", f"{format_value(found, 'aee')} / {format_value(found, 'aee_isotropic')}"),
        *to_rows(found, "noise", "explained", "converged"),
    ]


def _lowered(reasons: Sequence[Doubt]) -> str:
    """Why nothing is identified; empty without a reason."""
    return next((one.text for one in reasons if one.allows == "unidentified"), "")


def _axis(found: AxisEstimate, k: int) -> str:
    return "(" + ", ".join(f"{x:.2g}" for x in found.axes[:, k]) + ")"


def _yield_rows(found: YieldEstimate) -> Rows:
    low, high = found.yield_strain.interval
    strain = f"{found.yield_strain.value:.4g} ({low:.4g} to {high:.4g})" if high is not None else f"above {low:.4g}"
    unsure = "no yield is identified" if high is None else "it yielded, but the yield strain is not identified"
    meaning = {
        "identified": "the motion determines it well",
        "weak": "the motion determines it roughly",
        "at-bound": "it yields at the smallest strain that the data resolve",
        "unidentified": _lowered(found.reasons) or unsure,
    }
    return [
        ("yield strain", strain),
        ("verdict", f"{found.verdict}: {meaning[found.verdict]}"),
        *reason_rows(found.reasons),
        *to_rows(found, "largest_strain", "beta", "creep", "set"),
        ("error, yielding / elastic", f"{format_value(found, 'aee')} / {format_value(found, 'elastic_aee')}"),
        *to_rows(found, "explained"),
        *_unloading(found.settings),
        *to_rows(found, "converged"),
    ]


def _unloading(settings: dict[str, object]) -> Rows:
    """Source of the push's end."""
    cycle = settings.get("unloading")
    if not isinstance(cycle, dict):
        return []
    source = {
        "displacement": "it rests from this frame on: the tool is assumed to be off; --at gives other frames",
        "force": "no force from this frame on",
        "given": "as named",
    }[str(cycle["source"])]
    left = f"{float(cycle['kept_share']):.0%} of the indentation is left"
    return [("unloaded", f"from frame {cycle['unloaded_frame']} on, {left} ({source})")]


def _field_rows(found: FieldEstimate) -> Rows:
    meaning = {
        "uniform": "no place differs from the others within the data's accuracy",
        "anisotropic": "one material, stiffer along one direction; no place differs from the others",
        "materials": f"{found.materials} materials with sharp borders",
        "gradual": "it changes gradually from place to place",
        "unidentified": "the relative stiffness of most places is not identified",
    }[found.verdict]
    metres = 1.0 if found.unit == "m" else found.metres_per_unit
    absolute = "positions alone determine only relative stiffness: give a force (--force-n)"
    if found.absolute is not None and metres is None:
        absolute = "in N/m with the scale of the images (--px-per-cm)"
    elif found.absolute is not None:
        assert metres is not None
        soft, stiff = found.absolute.min() / metres, found.absolute.max() / metres
        absolute = (
            f"{soft:.4g} to {stiff:.4g} N/m (modulus times {'thickness' if found.place.shape[1] == 2 else 'spacing'})"
        )
    rows = [
        *to_rows(found, "ratio"),
        ("verdict", f"{found.verdict}: {_lowered(found.reasons) or meaning}"),
        *reason_rows(found.reasons),
        *to_rows(found, "determined", "directions"),
    ]
    for number, one in enumerate(found.levels() if found.materials > 1 else []):
        numbers = f"{one['stiffness_over_softest']:.3g} times the softest, beta {one['beta']:.2g}, {one['share']:.0%}"
        rows.append((f"material {number + 1}", numbers))
    return [
        *rows,
        ("stiffness of a cell", absolute),
        ("beta", f"{found.beta.min():.3g} to {found.beta.max():.3g}"),
        *to_rows(found, "poisson"),
        *[
            (name, f"probability {likely:.2f} (left-out data: {error:.3g} times its noise)")
            for name, likely, error in zip(found.tried, found.probability, found.held_out, strict=True)
        ],
        *to_rows(found, "noise"),
        ("error, elastic / beta", f"{format_value(found, 'aee')} / {format_value(found, 'beta_aee')}"),
        *to_rows(found, "explained", "converged"),
    ]


def _recovery_rows(found: RecoveryEstimate) -> Rows:
    meaning = {
        "elastic": "it recovers immediately, within the data's accuracy",
        "viscous": "the rest of the indentation recovers with time",
        "plastic": "a part of the indentation is permanent, the rest recovers immediately",
        "viscoplastic": "a part of the indentation recovers with time, and a part is permanent",
        "unidentified": "whether it relaxes, or has a permanent set, is not identified",
    }[found.verdict]
    relaxes = found.verdict not in ("elastic", "plastic")
    return [
        *to_rows(found, "share"),
        *(to_rows(found, "time_s") if relaxes else [("mean relaxation time", "no relaxation is identified")]),
        ("permanent set", f"{format_value(found, 'set')} of the push"),
        ("verdict", f"{found.verdict}: {_lowered(found.reasons) or meaning}"),
        *reason_rows(found.reasons),
        *to_rows(found, "force_kept", "instant", "relaxed", "largest"),
        ("held, then watched", f"{found.held_s:.3g} s, {found.watched_s:.3g} s after frame {found.released}"),
        *to_rows(found, "explained"),
    ]
