"""The web viewer is that of the installed rerun, and no other user of the machine can give another one."""

import asyncio
import os
import re
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from deformscope.errors import InputError
from deformscope.page.server import viewer_files
from deformscope.page.server.viewer_files import NAMES, ViewerFiles, viewer_environment, viewer_executable
from tests.patience import PATIENCE_S
from tests.second_user import FOREIGN, taking_ports


def content(files: ViewerFiles, name: str) -> bytes:
    async def joined() -> bytes:
        return b"".join([part async for part in files.parts(name)])

    size = files.size(name)
    whole = asyncio.run(joined())
    assert len(whole) == size
    return whole


@pytest.fixture
def served_by_rerun() -> Iterator[str]:
    """Address of rerun's own server of its web viewer."""
    options = ["--bind", "127.0.0.1", "--port", "0", "--serve-web", "--web-viewer-port", "0"]
    with tempfile.TemporaryFile() as said:
        environment = viewer_environment() | {"RUST_LOG": "info"}
        process = subprocess.Popen([str(viewer_executable()), *options], env=environment, stdout=said, stderr=said)
        try:
            deadline = time.monotonic() + PATIENCE_S
            while not (found := re.search(rb"(?<!\+)http://127\.0\.0\.1:\d+", os.pread(said.fileno(), 10_000, 0))):
                assert time.monotonic() < deadline
                assert process.poll() is None
                time.sleep(0.02)
            yield found[0].decode()
        finally:
            process.kill()
            process.wait()


def test_they_are_those_that_rerun_serves(served_by_rerun: str) -> None:
    files = ViewerFiles()
    for name in NAMES:
        with urllib.request.urlopen(f"{served_by_rerun}/{name}", timeout=PATIENCE_S) as answer:
            assert content(files, name) == answer.read()
    files.close()


@pytest.mark.slow
def test_another_user_loses_the_race_for_the_script() -> None:
    with taking_ports() as taken:
        for _ in range(100):
            files = ViewerFiles()
            script = content(files, "re_viewer.js")
            files.close()
            assert script.startswith(b"let wasm_bindgen")
            assert FOREIGN not in script[:100]
        assert taken() == []


def test_an_executable_without_them_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    executable = tmp_path / "rerun"
    for bad in (b"x", b"\0asm\1\0\0\0", b"let wasm_bindgen = \n})({ __proto__: null });\n\0asm\1\0\0\0\1\xff\x7f"):
        executable.write_bytes(bad)
        monkeypatch.setattr(viewer_files, "viewer_executable", lambda: executable)
        with pytest.raises(InputError, match="web viewer"):
            ViewerFiles().size("re_viewer.js")
