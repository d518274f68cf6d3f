"""The files that set a KUKA controller up for this driver: as shipped, and for a configuration."""

from __future__ import annotations

from pathlib import Path

from deformscope_drivers.kuka.config import KukaConfig

FOLDER = Path(__file__).parent / "controller_files"
"""The shipped files belong to KukaConfig(address="192.168.1.25")."""
TIMEOUT_S = 0.06
"""Time of missing answers after which RSI ends; opening leaves two out. Chosen."""


def controller_files(config: KukaConfig) -> dict[str, str]:
    """Name and text of each file: with the configuration's address (the shipped one if it is 0.0.0.0), port and
    sen_type, and its cycle. joint_limit_deg_s gives the limit of a cycle's correction, TIMEOUT_S that of missing
    answers, in cycles."""
    address = "192.168.1.25" if config.address == "0.0.0.0" else config.address
    limit = f'{config.joint_limit_deg_s * config.cycle_s:.4g}"'
    timeout = f'="{round(TIMEOUT_S / config.cycle_s)}"'
    changes = (
        ("<IP_NUMBER>192.168.1.25<", f"<IP_NUMBER>{address}<"),
        ("<PORT>59152<", f"<PORT>{config.port}<"),
        ("<SENTYPE>ImFree<", f"<SENTYPE>{config.sen_type}<"),
        ("#IPO)", "#IPO)" if config.cycle_s == 0.012 else "#IPO_FAST)"),
        ('0.24"', limit),
        ('"Timeout" ParamID="1" ParamValue="5"', f'"Timeout" ParamID="1" ParamValue{timeout}'),
        ('"Timeout" value="5"', f'"Timeout" value{timeout}'),
    )
    texts = {path.name: path.read_text("utf-8") for path in sorted(FOLDER.iterdir())}
    for shipped, wanted in changes:
        texts = {name: text.replace(shipped, wanted) for name, text in texts.items()}
    return texts
