"""Which stiffness of a touch is mapped: during the approach, or relaxed. `ExploreOptions.quantity` chooses."""

from __future__ import annotations

import dataclasses

import numpy as np

from deformscope.errors import InputError
from deformscope.stages.poke.creep import REFERENCE_SPEED_M_S, CreepFit
from deformscope.stages.regions.touch_error import LAW_SD
from deformscope.stages.regions.touches import StiffnessSample

SPEED_SD = 0.03
"""Change of log stiffness for each e-fold of the approach speed, for touches without a fitted creep. Assumed: a third
of the modulus relaxes evenly over three decades of time."""


class ApparentStiffness:
    """Stiffness of each touch during its approach, at its own speed."""

    def stiffness(
        self, felt: StiffnessSample, creep: CreepFit | None, speed_m_s: float | None
    ) -> StiffnessSample | None:
        """The stiffness with which touches are compared; None if the touch does not determine it.

        felt: the stiffness of the contact; creep: the touch's creep, None if it was not fitted; speed_m_s: speed of the
        approach in contact, None where it is not known"""
        return felt


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
