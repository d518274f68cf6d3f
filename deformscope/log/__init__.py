"""How results are logged: a view for each type of result. Views and recording by rerun: only this package and the
recorder import it."""

import os

os.environ.setdefault("RUST_LOG", "off")  # rerun reads it as it is imported; what it would print, the recorder says
