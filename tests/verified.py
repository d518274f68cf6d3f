"""`deformscope verify` of a recording that a test has made."""

from pathlib import Path

import pytest

from deformscope.cli import main


def verify_here(path: Path, *flags: str) -> int:
    """Exit status of `deformscope verify`. The content is read in this process, in a second less: that damaged bytes
    end a process of its own is tested with the command (`tests/cli/test_verify_command.py`)."""
    from deformscope.recording.facts import gather_facts

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deformscope.runs.verification.read_facts", gather_facts)
        return main(["verify", str(path), *flags])
