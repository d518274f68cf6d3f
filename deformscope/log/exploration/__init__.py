"""The recording and views of an exploration: `layout` is its part of the recorder."""
