"""`deformscope catalog`: the recordings of a folder, listed, filtered and compared."""

from __future__ import annotations

from deformscope.cli.common import fit_progress, keep_page, say, show, write_file, write_json, wrote
from deformscope.config import CatalogConfig, CompareConfig


def run(config: CatalogConfig) -> None:
    """List the recordings, after the index is made or updated."""
    from deformscope.runs.catalog import PAGE, catalog_page, catalogue, serve_page

    names = [name.strip() for name in config.columns.split(",") if name.strip()]
    with fit_progress() as progress:
        found = catalogue(config.folder, config.where, config.sort, names, workers=config.workers, progress=progress)
        page = catalog_page(found, workers=config.workers, progress=progress) if config.page else None
        if config.serve:
            serve_page(found, config.workers, progress)
    show(found)
    if page is not None:
        write_file(config.folder / PAGE, page.encode())
        wrote("page", config.folder / PAGE)
    if config.json is not None:
        write_json(found.as_json(), config.json)
    if config.serve:
        keep_page(served=True)


def compare(config: CompareConfig) -> None:
    """Print the differences of two recordings."""
    from deformscope.runs.catalog import compare_recordings

    found = compare_recordings(config.first, config.second)
    show(found)
    if found.unaligned:
        say(f"not aligned by contact: {found.unaligned}")
    write_json(found.as_json(), config.json)
