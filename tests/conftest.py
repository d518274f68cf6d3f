"""What all tests share. A GPU machine may lack rerun, open3d, pyserial and tyro: nothing here imports them."""

import fcntl
import gc
import importlib.util
import os
import signal
import tempfile
from collections.abc import Generator, Iterable
from pathlib import Path
from typing import Any

import pytest

from deformscope_drivers import transport
from tests.patience import PATIENCE_S

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in the background, as by nohup: else no program that a test starts would know Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
os.environ["MPLBACKEND"] = "Agg"
os.environ["RUST_LOG"] = "off"  # rerun's own chatter
transport.WRITE_TIMEOUT_S = PATIENCE_S  # a thread that a busy machine stops in the middle of a write has not failed

PACKAGES = {"warp", "tyro", "rerun", "open3d", "serial", "cv2", "sklearn", "skfem", "threadpoolctl"}
"""Without which the other tests run."""
SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real recordings that are too large to be kept in the repository; they lie beside a checkout where there are any."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Of several test processes the first collects alone: its assertions are then rewritten for all. Python looks for
    garbage neither while thousands of tests are collected nor later among what was collected."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
    with (Path(tempfile.gettempdir()) / f"deformscope-tests-{run}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            fcntl.flock(lock, fcntl.LOCK_SH)
        gc.disable()
        try:
            return (yield)
        finally:
            Path(lock.name).unlink(missing_ok=True)
            gc.freeze()
            gc.enable()


class OptionalModule(pytest.Module):
    """Skipped where a package that it imports is not installed."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        try:
            return super().collect()
        except self.CollectError as error:
            if not isinstance(error.__cause__, ModuleNotFoundError) or error.__cause__.name not in PACKAGES:
                raise
            pytest.skip(f"no {error.__cause__.name} here", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    return OptionalModule.from_parent(parent, path=module_path)


def pytest_configure() -> None:
    _compile_kernels_once()
    _make_parsers_once()


def _make_parsers_once() -> None:
    """Tests read a thousand command lines; tyro would make each command's parser anew, 10 to 50 ms long."""
    if importlib.util.find_spec("tyro") is None:
        return
    from tyro._parsers import ParserSpecification

    plain, made = ParserSpecification.from_callable_or_type, dict[tuple[object, ...], ParserSpecification]()

    def once(f: Any, **named: Any) -> ParserSpecification:
        if named["intern_prefix"] or named["parent_classes"]:  # a part of another one
            return plain(f, **named)
        key = f, named["description"], id(named["default_instance"])
        if key not in made:
            made[key] = plain(f, **named)
        return made[key]

    ParserSpecification.from_callable_or_type = staticmethod(once)  # type: ignore[method-assign]


def _compile_kernels_once() -> None:
    """Of several test processes one compiles a module of kernels while the others wait; warp would let each do so."""
    if "PYTEST_XDIST_WORKER" not in os.environ or importlib.util.find_spec("warp") is None:
        return
    import warp as wp

    plain = wp.Module.load

    def load(self: Any, *args: Any, **kwargs: Any) -> Any:
        if self.execs:  # every launch comes here
            return plain(self, *args, **kwargs)
        folder = Path(wp.config.kernel_cache_dir)
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / f"{self.name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return plain(self, *args, **kwargs)

    wp.Module.load = load


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """First those that parse every file: one process does so for all of them. Then the drivers' tests: they need no
    kernels, so that of two test processes the other has compiled them when both need them; and they wait for doubles,
    while the other computes."""
    first = ("tests/test_imports.py", "tests/test_structure.py"), ("tests/drivers/",)
    items.sort(key=lambda item: [not item.nodeid.startswith(ones) for ones in first])


@pytest.fixture(params=["cpu", pytest.param("cuda:0", marks=pytest.mark.cuda)])
def device(request: pytest.FixtureRequest) -> str:
    """Each of warp's devices in turn; one that this machine lacks is skipped."""
    wp = pytest.importorskip("warp")
    wp.config.quiet = True
    wp.init()
    name: str = request.param
    if name == "cpu" and not wp.is_cpu_available():
        pytest.skip("this warp has no CPU device")
    if name.startswith("cuda") and wp.get_cuda_device_count() == 0:
        pytest.skip("warp finds no CUDA device")
    return name


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real recordings beside the checkout; skips where there is none."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no folder of real recordings beside the checkout ({SHARED_DATA.parent.name}/{SHARED_DATA.name})")
    return SHARED_DATA
