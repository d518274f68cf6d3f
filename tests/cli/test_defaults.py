"""Defaults of options in Python are those of the command's flags: scripts, studies and tests run what users run."""

import ast
import dataclasses
import importlib
import inspect
from pathlib import Path
from typing import Any, Literal

import pytest

import deformscope
import deformscope.config
from deformscope import library
from deformscope.config.options import Flags
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.runs.opened_devices import setup_of
from deformscope.stages.map.plan import PlanOptions

PACKAGE = Path(deformscope.__file__).parent
COMMANDS: dict[str, tuple[str, ...]] = {
    "EvaluationOptions": ("ClassifyConfig",),
    "ExploreOptions": ("ExploreConfig",),
    "FitOptions": ("BetaConfig",),
    "LayersOptions": ("BetaConfig",),
    "LiveOptions": ("RecordConfig", "LiveConfig"),
    "MaterialJob": ("AxesConfig", "FieldConfig", "YieldConfig", "ViscousConfig"),
    "ParticleOptions": ("BetaConfig", "ThetaConfig", "RecordConfig"),
    "PlanOptions": ("ExploreConfig",),
    "PushOptions": ("BetaConfig", "ThetaConfig"),
    "SweepOptions": ("SweepConfig",),
    "TrackOptions": (),
    "UnloadingOptions": ("YieldConfig", "ViscousConfig"),
    "YieldOptions": ("YieldConfig",),
}
"""The commands whose flags set each class of options outside `deformscope.config`."""
FUNCTIONS = {
    "compare_recordings": "CompareConfig",
    "discard": "DiscardRecordingConfig",
    "import_recording": "ImportConfig",
}
"""Functions of the library whose options are not named like them."""
OTHERS = {
    "device": "the flags choose the machine's",
    "viewer": "a script opens no window that it does not ask for",
    "detail": "nothing keeps what is computed for a recording alone",
}
"""Fields whose defaults may differ, and why."""


def options_classes() -> dict[str, type]:
    """The classes of options outside `deformscope.config`, by name."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        for one in ast.parse(path.read_text(encoding="utf-8")).body:
            named = isinstance(one, ast.ClassDef) and one.name.endswith(("Options", "Job"))
            place = path.relative_to(PACKAGE).with_suffix("").parts
            if named and place[0] not in ("config", "reproduce", "bench"):
                found[one.name] = getattr(importlib.import_module(".".join(("deformscope", *place))), one.name)
    return found


def defaults(kind: type) -> dict[str, Any]:
    """The defaults that a class states, by field; those of its groups of flags too."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        make = field.default_factory
        if isinstance(make, type) and issubclass(make, Flags):
            found |= defaults(make)
        elif field.default is not dataclasses.MISSING:
            found[field.name] = field.default
        elif make is not dataclasses.MISSING:
            found[field.name] = make()
    return found


def differing(here: dict[str, Any], command: str) -> dict[str, tuple[Any, Any]]:
    """Defaults that differ from those of a command's flags; None and () follow from other options."""
    flags = defaults(getattr(deformscope.config, command))
    both = {name: (here[name], flags[name]) for name in here.keys() & flags.keys() - OTHERS.keys()}
    return {name: pair for name, pair in both.items() if pair[0] != pair[1] and not {None, ()} & set(pair)}


def test_every_class_of_options_has_the_defaults_of_its_flags() -> None:
    classes = options_classes()
    assert classes.keys() == COMMANDS.keys()
    found = {
        f"{name}, {command}": differing(defaults(classes[name]), command)
        for name, commands in COMMANDS.items()
        for command in commands
    }
    assert {name: pairs for name, pairs in found.items() if pairs} == {}


def test_every_function_of_the_library_has_the_defaults_of_its_command() -> None:
    found = {}
    for name, function in inspect.getmembers(library, inspect.isfunction):
        command = FUNCTIONS.get(name) or f"{name.removeprefix('calibrate_').title().replace('_', '')}Config"
        if function.__module__ == library.__name__ and hasattr(deformscope.config, command):
            given = inspect.signature(function).parameters.values()
            stated = {one.name: one.default for one in given if one.default is not one.empty}
            found[name] = differing(stated, command)
    assert len(found) > 10
    assert {name: pairs for name, pairs in found.items() if pairs} == {}


def test_a_difference_would_be_seen() -> None:
    assert differing({"threshold": 0.1, "feel": "apparent", "budget": 3}, "ExploreConfig") == {"threshold": (0.1, 0.06)}


@pytest.mark.parametrize("given", [{}, {"goal": "inclusions"}])
def test_options_of_explorations_are_those_of_the_command(given: dict[str, Any]) -> None:
    """Those too that follow from the goal."""
    options, flags = ExploreOptions(**given), deformscope.config.ExploreConfig(rig="lab:disc", **given)
    for name in ("budget", "beta_model", "threshold", "border_m"):
        assert getattr(options, name) == getattr(flags, name), name
    if not given:
        assert options.planning == PlanOptions()


@pytest.mark.parametrize(("asked", "is_now"), [(None, "held"), ("held", "held"), ("free", "free")])
def test_a_simulated_scene_leaves_the_tangent_free_where_it_is_asked_for(
    asked: Literal["held", "free"] | None, is_now: str
) -> None:
    opening = setup_of("lab:homogeneous-60", ExploreOptions(), None, trusted=True, tangential=asked)
    assert opening.options.tangential == is_now
