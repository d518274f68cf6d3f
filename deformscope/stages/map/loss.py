"""Maps of the share of energy that a touch loses, instead of stiffness: equally stiff foams may differ in it.

The share is used by its logarithm, as stiffness is, in which regions differ and touches have relative errors. Shares
below LEAST_LOSS count as LEAST_LOSS, so that elastic and rigid parts are one material. The loss depends on the touch's
speed and the duration of its hold, which are the same for all touches of an exploration. The gain of the force has no
effect, and neither has the shape of the surface, which changes stored and returned energy alike.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.map.exploration import MapEstimate
from deformscope.stages.map.field import fit_field, levels_of
from deformscope.stages.poke.contact import Z_90
from deformscope.stages.poke.creep import CreepFit
from deformscope.stages.regions.touches import MapGrid, StiffnessSample

LEAST_LOSS = 0.02
"""Smallest share of the energy: noise of force and place, and friction, give this share in a foam without losses."""
RIGID_LOSS_SD = 0.25
"""Deviation of the log of a rigid part's loss, which was not measured [assumed]."""


def loss_sample(xy_m: FloatArray, creep: CreepFit | None, *, rigid: bool) -> StiffnessSample:
    """The sample of the loss by a touch at a place (2,) [m], with its logarithm in place of that of stiffness.

    Raises InputError if its way back does not determine the loss.
    """
    if rigid:
        return StiffnessSample(xy_m, float(np.log(LEAST_LOSS)), RIGID_LOSS_SD)
    if creep is None or creep.loss is None or creep.loss_interval is None:
        raise InputError("a touch whose force returned to zero", "one without", "check its creep")
    low, high = creep.loss_interval
    loss = max(creep.loss, LEAST_LOSS)
    return StiffnessSample(xy_m, float(np.log(loss)), max((high - low) / (2.0 * Z_90 * loss), 1e-3))


def by_loss(maps: MapEstimate, felt: Sequence[StiffnessSample]) -> MapEstimate:
    """Maps of the log loss, with its names; and stiffness, as a field through the touches."""
    rows, columns = maps.labels.shape
    grid = MapGrid((columns * maps.cell_m, rows * maps.cell_m), maps.cell_m)
    places, log_stiffness, sd = (
        np.array([getattr(one, name) for one in felt]) for name in ("xy_m", "log_stiffness", "log_sd")
    )
    field = fit_field(places, log_stiffness, sd).on(grid)
    level, interval = levels_of(field.mean, field.deviation, maps.labels, maps.region_count)
    return dataclasses.replace(
        maps,
        loss=maps.stiffness_n_per_mm,
        loss_log_sd=maps.stiffness_log_sd,
        level_loss=maps.level_n_per_mm,
        level_loss_interval=maps.level_interval_n_per_mm,
        stiffness_n_per_mm=np.exp(field.mean),
        stiffness_log_sd=field.deviation,
        level_n_per_mm=np.exp(level),
        level_interval_n_per_mm=np.exp(interval),
        level_rigid=np.zeros(maps.region_count, dtype=bool),
    )
