"""`deformscope report`: the figures of a recording, as one HTML page.

deformscope report run.rrd
deformscope report run.rrd --out run.html
"""

from __future__ import annotations

from deformscope.cli.common import check_writable, say, show, write_file, write_json, wrote
from deformscope.config import ReportConfig
from deformscope.runs.recording_report import report_recording


def run(config: ReportConfig) -> None:
    """Draw the figures, and list missing stages."""
    out = config.recording.with_suffix(".html") if config.out is None else config.out
    check_writable(out, "--out")
    found = report_recording(config.recording)
    write_file(out, found.page().encode())
    show(found)
    say(f"stages missing: {', '.join(found.lacks) or 'none'}")
    wrote("report", out)
    write_json({**found.to_dict(), "report": out}, config.json)
