"""A squeeze as a trial of a data set, and as the settings of its recording."""

from __future__ import annotations

import dataclasses
import datetime
from typing import Any

from deformscope.experiments.squeeze.features import SqueezeGeometry, TrialFeatures
from deformscope.experiments.squeeze.squeezing_hand import rule_of
from deformscope.files.squeeze_dataset import TrialEntry, TrialRow
from deformscope.robot.squeeze_setup import SqueezeSetup
from deformscope.stages.squeeze.patch import SIDE_PX
from deformscope.stages.squeeze.trial import PHYSICAL
from deformscope.version import __version__


def feature_settings(setup: SqueezeSetup) -> dict[str, Any]:
    """Settings of a data set's features: features compare only if their settings are equal."""
    return {"tactile_end": setup.hand.tactile_end, "patch_px": SIDE_PX, "physical": list(PHYSICAL)}


def recorded_settings(setup: SqueezeSetup) -> dict[str, Any]:
    """Settings that a recording needs so that its results can be computed again."""
    recorded = {"names": dataclasses.asdict(setup.names), "rule": dataclasses.asdict(rule_of(setup))}
    recorded |= {"squeeze": dataclasses.asdict(setup.squeeze), "features": feature_settings(setup)}
    return {"squeezed": recorded | {"geometry": SqueezeGeometry.of(setup).as_json()}, "simulated": setup.simulated}


def entry_of(setup: SqueezeSetup, content: str, container: str, session: str, seed: int) -> TrialEntry:
    """The trial's entry before it was squeezed."""
    return TrialEntry(
        trial=f"{session}-{container or 'container'}-{seed:05d}",
        content=content,
        container=container,
        container_type=setup.container.kind,
        session=session,
        T_hand_container=tuple(map(float, setup.grasp.T_hand_container.ravel())),
        seed=seed,
        software=f"deformscope {__version__}",
        recorded_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )


def row_of(entry: TrialEntry, features: TrialFeatures | None) -> TrialRow:
    """The entry with its features, if there are any."""
    if features is None:
        return TrialRow(entry)
    return TrialRow(entry, features.modalities, features.series)
