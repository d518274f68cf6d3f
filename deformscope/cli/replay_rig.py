"""`deformscope replay` of a rig's recording: its bytes decoded again and compared with its frames, and what stages
found beside them computed again."""

from __future__ import annotations

import dataclasses
from typing import Any

from deformscope.cli.common import Different, say, show_table, write_json
from deformscope.config import ReplayConfig
from deformscope.experiments.replay_stages import ReplayedStages, replay_stages
from deformscope.pictures.words import failed_words
from deformscope.recording.items import ITEMS, read_rows, read_streams
from deformscope.recording.reader import Replay
from deformscope.rig.decoded import compare_with_bytes
from deformscope.rig.rig_file import parse_rig


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
    stages = _replay_stages(config) if "stages" in settings else None
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


def _replay_stages(config: ReplayConfig) -> ReplayedStages:
    return replay_stages(config.recording, trust=True)


def _in_words(share: float) -> str:
    """share: the largest difference"""
    return f"DIFFERENT by {share:.2g}" if share > 0.0 else "computed again, identical"
