"""`deformscope replay`: the same stages on the recorded inputs, compared with the recorded numbers; of a rig, its bytes
decoded again and compared with its frames.

deformscope replay out.rrd
deformscope replay out.rrd --viewer native --pace real
deformscope replay out.rrd --record again.rrd --json -
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import (
    Different,
    check_same,
    console,
    fit_progress,
    quiet_warp,
    say,
    show,
    show_table,
    write_json,
)
from deformscope.config import ReplayConfig
from deformscope.errors import InputError
from deformscope.experiments.replay_stages import replay_stages
from deformscope.pictures.words import failed_words
from deformscope.recording.item_rows import read_rows
from deformscope.recording.items import ITEMS, read_estimates, read_streams
from deformscope.recording.reader import Replay
from deformscope.rig.decoded import compare_with_bytes
from deformscope.rig.rig_file import parse_rig
from deformscope.rows import differing

if TYPE_CHECKING:
    from deformscope.frames import ColorFrame
    from deformscope.stages.fit.estimate import Estimate

CLOSE = 0.01
"""Largest difference that another machine's arithmetic may make: of the value and its interval as a share of the
interval's width, of an error as a share of itself. On one machine there is none."""


def run(config: ReplayConfig) -> None:
    """Recompute a recording from its inputs; raises `Different` where the numbers do not come out as recorded."""
    import msgspec

    from deformscope.api.calibration import calibrate_pair_bytes, run_images
    from deformscope.experiments.foam_video import ParticleOptions
    from deformscope.experiments.poke_files import LayersOptions
    from deformscope.experiments.whole_motion import Selectable
    from deformscope.files.sources import Source
    from deformscope.recording.reader import Replay
    from deformscope.stages.fit.calibrate import FitOptions
    from deformscope.stages.msm.solver import pick_device

    quiet_warp()
    recording = Replay(config.recording)
    settings = dict(recording.settings)
    if config.beside is not None:
        align(recording, Replay(config.beside), config)
        return
    page = None
    if config.output.viewer == "page" and settings.keys() & {"explore", "squeezed", "rig"}:
        from deformscope.page.playback import play_on_page

        page = play_on_page(config.recording)
    if "explore" in settings:
        from deformscope.cli.replay_exploration import replay_exploration

        replay_exploration(recording, config, page)
        return
    if "squeezed" in settings:
        from deformscope.cli.replay_squeeze import replay_squeeze

        replay_squeeze(recording, config)
        return
    if config.set:
        raise InputError("--set with a recorded exploration", "a recording of another kind", where=config.recording)
    if "rig" in settings:
        replay_rig(recording, settings, config)
        return
    if "material" in settings:
        replay_recorded_material(recording, config)
        return
    try:
        fit = msgspec.convert(settings.pop("fit"), FitOptions)
        particles = msgspec.convert(settings.pop("particles", {}), ParticleOptions)
        motion = settings.pop("motion", None)
        select = None if motion is None else msgspec.convert(motion["select"], tuple[Selectable, ...])
    except (KeyError, msgspec.ValidationError) as error:
        raise InputError(
            "a recording of a calibration", f"settings of another kind ({error})", where=config.recording
        ) from error
    recorded = read_estimates(recording)
    if fit.model.device != "cpu":  # the recording's GPU may not be here
        fit = dataclasses.replace(fit, model=dataclasses.replace(fit.model, device=pick_device("auto")))
    pairs = recording.read_pair_bytes()
    with fit_progress() as progress:
        if pairs:
            names = list(settings.get("sources", [])) or [f"pair {index}" for index in range(len(pairs))]
            found = calibrate_pair_bytes(
                list(zip(names, pairs, strict=True)),
                fit,
                config.output,
                noise_m=settings.get("noise_m"),
                joint=bool(settings.get("joint")),
                layers=msgspec.convert(settings["layers"], LayersOptions) if "layers" in settings else None,
                progress=progress,
            )
        else:
            with Source(
                str(config.recording), lambda: recording.frames(config.pace, _wait), recording.frame_count
            ) as source:
                mask, output = recording.mask, config.output
                found = [run_images(source, mask, fit, particles, settings, output, select, progress)]
    show(*found)
    every = [one.to_dict() for one in found]
    write_json(every[0] if len(every) == 1 else every, config.output.json)
    _compare(recorded, [one.estimate for one in found], config)


def replay_recorded_material(recording: Replay, config: ReplayConfig) -> None:
    """What was found of a material, computed again. Raises `Different` where a number differs."""
    from deformscope.api.materials import replay_material
    from deformscope.files.sources import Source

    frames = Source(str(config.recording), lambda: recording.frames(config.pace, _wait), recording.frame_count)
    with fit_progress() as progress:
        recorded, found = replay_material(recording, frames, config.output, progress=progress)
    show(found)
    write_json(found.to_dict(), config.output.json)
    if not recorded:
        console().print("the recording holds no result (its run was cut short): nothing to compare with")
        return
    check_same(recorded[0], found.estimate, config.recording, ("settings",))
    console().print("replay: identical to the recorded numbers")


def align(first: Replay, second: Replay, config: ReplayConfig) -> None:
    """Show two recordings on a page, both from their first contact on; raises InputError where one has none."""
    from deformscope.page.aligned import align_on_page

    if config.output.viewer != "page" or config.set or config.output.record is not None:
        raise InputError("--beside with --viewer page, without --set or --record", "other options")
    _, contacts_s = align_on_page(first, second)
    paths = first.path, second.path
    rows = [(str(path), f"first contact at {at_s:.3f} s") for path, at_s in zip(paths, contacts_s, strict=True)]
    show_table("two recordings from their first contact on", rows)
    write_json({"beside": paths, "first_contact_s": contacts_s}, config.output.json)


def _wait(frame: ColorFrame) -> None:
    """Step by step: Enter takes the next frame."""
    console().print(f"frame {frame.index}: press Enter")
    if not sys.stdin.readline():
        raise InputError("Enter on the standard input for every frame", "its end", "--pace fast")


def _compare(recorded: list[Estimate], computed: list[Estimate], config: ReplayConfig) -> None:
    if not recorded:
        console().print("the recording holds no result (its run was cut short): nothing to compare with")
        return
    if len(recorded) != len(computed):
        raise Different(f"{len(recorded)} results as recorded", str(len(computed)), where=config.recording)
    pairs = list(zip(recorded, computed, strict=True))
    worst = max(_difference(before, now) for before, now in pairs)
    if worst > CLOSE:
        came = f"numbers that differ by {worst:.1%} of the interval or error"
        raise Different("the recorded numbers", came, "the versions in the recording's properties", config.recording)
    # the settings name the machine's own device
    identical = all(differing(before, now, ("settings",)) is None for before, now in pairs)
    same = "identical to" if identical else f"within {worst:.1g} (of the interval or error) of"
    console().print(f"replay: {same} the recorded numbers")


def _difference(before: Estimate, now: Estimate) -> float:
    """The largest difference of two estimates' headline numbers, in the units of `CLOSE`."""
    same = ("parameter", "unit", "metres_per_unit")
    if any(getattr(before, name) != getattr(now, name) for name in same):
        return math.inf
    low, high = before.interval
    width = max(high - low, 1e-6)
    ends = zip((before.value, low, high), (now.value, *now.interval), strict=True)
    errors = ((before.aee, now.aee), (before.aee_free, now.aee_free))
    return max(*(abs(b - n) / width for b, n in ends), *(abs(b - n) / max(abs(b), 1e-12) for b, n in errors))


def replay_rig(recording: Replay, settings: dict[str, Any], config: ReplayConfig) -> None:
    """Raises `Different` where a frame is not what its bytes give, or a stage's result not what its frames give."""
    rig = parse_rig(settings["rig"], settings.get("rig_name", "rig"))
    streams = read_streams(config.recording, trust=True)
    items = (row.item for row in read_rows(recording, ITEMS, lambda encoded, which: encoded))
    found = compare_with_bytes(rig, streams, items)
    different = [one for one in found if one.difference]
    rows = []
    for one in found:
        result = f"{one.compared} of {one.frames} frames decoded again" if one.compared else f"{one.frames} frames"
        result += f"; DIFFERENT: {one.difference}" if one.difference else ", identical" if one.compared else ""
        rows.append((one.device, result + (f"; not compared: {one.left_out}" if one.left_out else "")))
    stages = replay_stages(config.recording, trust=True) if "stages" in settings else None
    wrong = {} if stages is None else {name: share for name, share in stages.different.items() if share > 0.0}
    if stages is not None:
        rows += [(f"stage {name}", _in_words(share)) for name, share in stages.different.items()]
        rows += [("failed when recorded", failed_words(one)) for one in stages.failures]
    show_table(f"replay of {config.recording}", rows)
    report: dict[str, object] = {"devices": [dataclasses.asdict(one) for one in found]}
    report["identical"] = not (different or wrong)
    if stages is not None:
        report["stages"] = dataclasses.asdict(stages)
    write_json(report, config.output.json)
    if different:
        more = f" (and of {len(different) - 1} more devices)" if len(different) > 1 else ""
        raise Different("frames as their bytes give them", different[0].difference + more, where=config.recording)
    if wrong:
        came = ", ".join(f"{name} that differs by {share:.2g}" for name, share in wrong.items())
        raise Different("the recorded results of every stage, to the last bit", came, where=config.recording)
    if stages is not None:
        say(f"replay: {stages.results} results of stages computed again, identical to the recorded ones")
    say(f"replay: {sum(one.compared for one in found)} frames decoded again, identical to the recorded ones")


def _in_words(share: float) -> str:
    """share: the largest difference"""
    return f"DIFFERENT by {share:.2g}" if share > 0.0 else "computed again, identical"
