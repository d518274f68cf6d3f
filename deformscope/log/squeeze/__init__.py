"""The recording and views of a squeeze: `layout` is its part of the recorder."""
