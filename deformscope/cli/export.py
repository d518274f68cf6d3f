"""`deformscope export`: the images of a recording as files.

deformscope export r.rrd --images frames
deformscope export r.rrd --images frames --camera front
"""

from __future__ import annotations

from deformscope.cli.common import progress, show_table, write_json
from deformscope.config import ExportConfig


def run(config: ExportConfig) -> None:
    """Write them, byte for byte as they were recorded."""
    from deformscope.recording.export import export_images
    from deformscope.recording.reader import Replay

    replay = Replay(config.recording)
    total = sum(count for (device, what), count in replay.image_counts.items() if what != "color")
    with progress("images", total=None if config.camera else total) as done:
        found = export_images(replay, config.images, config.camera, overwrite=config.overwrite, done=done)
    show_table(
        str(config.recording), [(f"{one.what} of {one.device}", f"{one.count} in {one.folder}") for one in found]
    )
    write_json({"recording": config.recording, "images": found}, config.json)
