"""`deformscope export`: the images of a recording as files.

deformscope export r.rrd --images frames
deformscope export r.rrd --images frames --camera front
"""

from __future__ import annotations

from deformscope.cli.common import fit_progress, show_table, write_json
from deformscope.config import ExportConfig
from deformscope.recording.export import export_images
from deformscope.recording.reader import Replay


def run(config: ExportConfig) -> None:
    """Write them, byte for byte as they were recorded."""
    replay = Replay(config.recording)
    with fit_progress() as note:
        found = export_images(replay, config.images, config.camera, overwrite=config.overwrite, note=note)
    show_table(
        str(config.recording), [(f"{one.what} of {one.device}", f"{one.count} in {one.folder}") for one in found]
    )
    write_json({"recording": config.recording, "images": found}, config.json)
