"""What makes an exploration through the real drivers quick where its numbers prove nothing: foam in closed form in
place of finite elements, coarse maps of few particles, fewer places to plan, a short slow way down, and no drawing."""

import dataclasses
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.images import encode_png
from deformscope.lab.live_lab import LayerWorld
from deformscope.lab.ray_camera import DepthViewConfig
from deformscope.lab.scenes import Scene
from deformscope.lab.slab import RigidTip
from deformscope.robot.touch import TouchPlan
from deformscope.runs.opened_devices import Opening, setup_of
from deformscope.stages.regions.posterior import RegionPosterior

CELL_M = 0.02
"""Of the maps."""
PLAN_CELL_M = 0.06


def use_coarse_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on the posterior has few particles, and pictures are a pixel."""
    pixel = encode_png(np.zeros((1, 1, 3), np.uint8))
    monkeypatch.setattr("deformscope.pictures.exploration._one", lambda *_: pixel)
    monkeypatch.setattr("deformscope.pictures.exploration.result_png", lambda *_: pixel)
    few = SimpleNamespace(before_touches=partial(RegionPosterior.before_touches, particle_count=50))
    monkeypatch.setattr("deformscope.experiments.explore.options.RegionPosterior", few)


def use_quick_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on `explore` makes coarse maps of scenes in closed form."""
    use_coarse_maps(monkeypatch)
    for module in ("explore", "options"):
        monkeypatch.setattr(f"deformscope.experiments.explore.{module}.PLAN_CELL_M", PLAN_CELL_M)
    monkeypatch.setattr("deformscope.lab.scene_lab.slab_world", _Layers)
    monkeypatch.setattr("deformscope.lab.scene_lab.DepthViewConfig", _small_view)
    near = partial(TouchPlan, slow_within_m=0.01, far_speed_m_s=0.05, travel_speed_m_s=0.15)
    monkeypatch.setattr("deformscope.experiments.measured.TouchPlan", near)
    monkeypatch.setattr("deformscope.runs.exploration_run.setup_of", _coarse_setup_of)


def _coarse_setup_of(name: str, options: ExploreOptions, set_force_n: float | None, **flags: Any) -> Opening:
    return setup_of(name, dataclasses.replace(options, cell_m=CELL_M), set_force_n, **flags)


def _small_view(width: int, height: int, **view: Any) -> DepthViewConfig:
    """The same view in a quarter of the pixels."""
    return DepthViewConfig(width=width // 2, height=height // 2, **view)


class _Layers:
    """`LayerWorld` as a `SlabWorld` is asked."""

    def __init__(self, scene: Scene) -> None:
        self._world = LayerWorld(scene, radius_m=0.01)

    def press(self, tip: RigidTip, center_m: FloatArray) -> Any:
        return SimpleNamespace(
            center_m=center_m, force_n=self._world.press(center_m), node=np.arange(self._world.pressed[2] > 0.0)
        )

    def displaced_m(self, contact: Any, places_m: FloatArray) -> FloatArray:
        return self._world.displaced_m(places_m)
