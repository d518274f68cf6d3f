"""What several tests of commands look at: it is made once."""

import contextlib
import io

import pytest

from deformscope.cli import main
from tests.cli.recorded import Explore, Explored


@pytest.fixture(scope="session")
def explore(tmp_path_factory: pytest.TempPathFactory) -> Explore:
    """Records an exploration with finite elements, maps and pictures as users get them; each only once."""
    made: dict[tuple[str, ...], Explored] = {}

    def explored(*flags: str, touches: int = 1) -> Explored:
        flags = ("--touches", str(touches), *flags)
        if flags not in made:
            record = tmp_path_factory.mktemp("explored") / "e.rrd"
            files = {"--record": "rrd", "--json": "json", "--picture": "png", "--map": "npz"}
            outputs = [word for flag, kind in files.items() for word in (flag, str(record.with_suffix(f".{kind}")))]
            with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
                assert main(["explore", "lab:two-60-150", "--viewer", "none", *flags, *outputs]) == 0
            made[flags] = Explored(touches, record, out.getvalue(), err.getvalue())
        return made[flags]

    return explored


@pytest.fixture(params=[1, pytest.param(2, marks=pytest.mark.slow)], ids="{}-touches".format)
def explored(request: pytest.FixtureRequest, explore: Explore) -> Explored:
    return explore(touches=request.param)
