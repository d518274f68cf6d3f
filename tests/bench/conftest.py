"""These run with pytest-benchmark alone, which ordinary runs do not even load: `make bench-suite`."""

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    return None if config.pluginmanager.hasplugin("benchmark") else True
