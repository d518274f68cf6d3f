"""Which quantity of a touch is mapped: stiffness during the approach, relaxed stiffness, or the share of energy that is
lost. `ExploreOptions.quantity` chooses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.map.exploration import MapEstimate
from deformscope.stages.map.loss import by_loss, loss_sample
from deformscope.stages.poke.creep import REFERENCE_SPEED_M_S, CreepFit
from deformscope.stages.regions.touch_error import LAW_SD, TouchErrorModel
from deformscope.stages.regions.touches import StiffnessSample

SPEED_SD = 0.03
"""Change of log stiffness for each e-fold of the approach speed, for touches without a fitted creep. Assumed: a third
of the modulus relaxes evenly over three decades of time."""


class ApparentStiffness:
    """Stiffness of each touch during its approach, at its own speed."""

    def error(self, error: TouchErrorModel) -> TouchErrorModel:
        """Errors of the quantity, given those of stiffness."""
        return error

    def stiffness(
        self, felt: StiffnessSample, creep: CreepFit | None, speed_m_s: float | None
    ) -> StiffnessSample | None:
        """The stiffness with which touches are compared; None if the touch does not determine it.

        felt: the stiffness of the contact; creep: the touch's creep, None if it was not fitted; speed_m_s: speed of the
        approach in contact, None where it is not known
        """
        return felt

    def sample(self, stiffness: StiffnessSample, creep: CreepFit | None) -> StiffnessSample:
        """The map's sample of a touch of this stiffness. Raises InputError if it does not determine the quantity."""
        return stiffness

    def maps(self, maps: MapEstimate, stiffness: Sequence[StiffnessSample]) -> MapEstimate:
        """The maps, with the names of their quantities. stiffness: stiffness of every touch that has one"""
        return maps

    def stiffness_field(self, known: MapEstimate | None) -> tuple[FloatArray, FloatArray] | None:
        """(rows, columns) log stiffness [N/mm] and its deviation, if the newest maps have them in addition to the
        quantity; None if the mapped quantity is stiffness."""
        return None


class StiffnessAtReferenceSpeed(ApparentStiffness):
    """Stiffness at the reference speed of approach: of touches with measured creep."""

    def stiffness(
        self, felt: StiffnessSample, creep: CreepFit | None, speed_m_s: float | None
    ) -> StiffnessSample | None:
        if felt.rigid:
            return felt
        if creep is None:  # how much it would creep is not known
            speed_m_s = REFERENCE_SPEED_M_S if speed_m_s is None else max(speed_m_s, 1e-4)
            away = SPEED_SD * abs(float(np.log(speed_m_s / REFERENCE_SPEED_M_S)))
            return dataclasses.replace(felt, log_sd=float(np.hypot(felt.log_sd, away)))
        log_stiffness = felt.log_stiffness + creep.log_at_reference
        log_sd = float(np.hypot(felt.log_sd, creep.log_at_reference_sd))
        return dataclasses.replace(felt, log_stiffness=log_stiffness, log_sd=log_sd)


class RelaxedStiffness(ApparentStiffness):
    """Stiffness after complete relaxation."""

    def stiffness(
        self, felt: StiffnessSample, creep: CreepFit | None, speed_m_s: float | None
    ) -> StiffnessSample | None:
        if felt.rigid or creep is None:
            return felt if felt.rigid else None
        if creep.relaxed_n_per_mm is None or creep.relaxed_log_sd is None:
            raise InputError("a relaxed stiffness", creep.reasons[0].text, "a longer `hold_s`, or feel=apparent")
        log_sd = float(np.hypot(creep.relaxed_log_sd, LAW_SD))
        return dataclasses.replace(felt, log_stiffness=float(np.log(creep.relaxed_n_per_mm)), log_sd=log_sd)


class EnergyLoss(StiffnessAtReferenceSpeed):
    """The share of its energy that a touch loses, with stiffness."""

    def error(self, error: TouchErrorModel) -> TouchErrorModel:
        """An error of the sensor's gain changes the forces of approach and retract equally."""
        return dataclasses.replace(error, gain_sd=0.0)

    def sample(self, stiffness: StiffnessSample, creep: CreepFit | None) -> StiffnessSample:
        return loss_sample(stiffness.xy_m, creep, rigid=stiffness.rigid)

    def maps(self, maps: MapEstimate, stiffness: Sequence[StiffnessSample]) -> MapEstimate:
        return by_loss(maps, stiffness)

    def stiffness_field(self, known: MapEstimate | None) -> tuple[FloatArray, FloatArray] | None:
        return None if known is None else (np.log(known.stiffness_n_per_mm), known.stiffness_log_sd)
