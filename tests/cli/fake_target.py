"""Stands in for a simulator's process: a slab that answers as a spring, proportional to the modulus below the tip.

FAKE_TARGET says how it misbehaves: missing, crash, garbage, error, hang, slow, paced (each poke); deaf: it closes its
output and goes on; interrupt: a person presses Ctrl-C at its fifth run."""

import json
import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import Any

HOW = os.environ.get("FAKE_TARGET", "")
SOFTER = 0.8
"""Share of its typed modulus with which it answers, as simulators do."""


def main() -> None:
    for number, line in enumerate(sys.stdin):
        if HOW == "interrupt" and number == 5:
            os.kill(os.getppid(), signal.SIGINT)
        time.sleep(0.7 if HOW == "slow" else 0.0)
        asked = json.loads(line)
        if asked["do"] == "version":
            print(json.dumps({"error": "no module"} if HOW == "missing" else {"version": "0.0.1"}), flush=True)
            continue
        if HOW == "crash":
            print("it ran out of memory", file=sys.stderr)
            sys.exit(7)
        if HOW == "deaf":
            print("its output was closed", file=sys.stderr, flush=True)
            os.close(1)
        if HOW in ("hang", "deaf"):
            time.sleep(600.0)
        if HOW == "garbage":
            print("not JSON", flush=True)
        if HOW == "error":
            print(json.dumps({"error": "ValueError: unknown attribute 'dof'"}), flush=True)
        given = asked["parameters"]
        if asked["do"] == "hold" and not HOW:
            print(json.dumps(held(asked["asset"], asked["by_m"], given)), flush=True)
            continue
        for poke in asked["pokes"] if HOW in ("", "slow", "paced", "interrupt") else ():
            time.sleep(0.7 if HOW == "paced" else 0.0)
            area = poke["size_m"][0] * poke["size_m"][-1]
            young = given["young"][material_at(asked["asset"], poke["at_m"])]
            force = [SOFTER * young * area / 0.03 * depth for depth in poke["depth_m"]]
            rest = vertices_of(asked["asset"])
            moved = [[0.0, 0.0, -poke["depth_m"][-1] * (abs(x - poke["at_m"][0]) < 0.01)] for x, _, _ in rest]
            print(
                json.dumps(
                    {
                        "force_n": force,
                        "penetration_m": [0.0] * len(force),
                        "rest_m": rest,
                        "moved_m": moved,
                        "step_s": 0.001,
                        "how": {"steps": 7},
                    }
                ),
                flush=True,
            )


def held(asset: str, by: list[list[float]], given: dict[str, Any]) -> dict[str, object]:
    """Free nodes rise by a hundredth of Poisson's ratio in metres; a held one resists with a thousandth of the modulus
    for each metre of its way."""
    ways, moved, force = iter(by), [], []
    for mocap in re.findall(r'<body name="n\d+" pos="[^"]+"( mocap="true")?>', Path(asset).read_text("utf-8")):
        moved.append(next(ways) if mocap else [0.0, 0.0, 0.01 * given["poisson"]])
        force.append([1e-3 * given["young"][0] * one for one in moved[-1]] if mocap else [0.0] * 3)
    return {"moved_m": moved, "force_n": force}


def material_at(asset: str, at: list[float]) -> int:
    """The material of the flex below a place."""
    for name, text in re.findall(r'<flex name="material(\d+)[^>]+ vertex="([^"]+)"', Path(asset).read_text("utf-8")):
        numbers = [float(one) for one in text.split()]
        if all(min(numbers[axis::3]) <= at[axis] <= max(numbers[axis::3]) for axis in (0, 1)):
            return int(name)
    return 0


def vertices_of(asset: str) -> list[list[float]]:
    text = Path(asset).read_text(encoding="utf-8")
    if asset.endswith(".usda"):
        numbers = re.findall(r"[-\d.e]+", text.split("points = [")[1].split("]")[0])
    else:
        numbers = " ".join(re.findall(r'<body name="n\d+" pos="([^"]+)"', text)).split()
    return [[float(one) for one in numbers[at : at + 3]] for at in range(0, len(numbers), 3)]


main()
