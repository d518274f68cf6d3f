"""warp without its greeting."""

import os
import sys
import tempfile
import threading

GREETING = b"Warp CUDA warning"
"""Begin of the line of its warning of a missing GPU driver, below Python: that is no fault here."""
_one_at_a_time = threading.Lock()
_started = False


def quiet_warp() -> None:
    """Start warp without its greeting, once: stderr of other threads is delayed by a moment."""
    global _started
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    with _one_at_a_time:
        if _started:
            return
        _started = True
    with tempfile.TemporaryFile() as meanwhile:
        sys.stderr.flush()
        kept = os.dup(2)
        os.dup2(meanwhile.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            meanwhile.seek(0)
            os.write(kept, b"".join(line for line in meanwhile if not line.startswith(GREETING)))
            os.close(kept)
