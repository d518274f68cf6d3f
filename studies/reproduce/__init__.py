"""The experiments of the thesis, in the laboratory: `python -m studies reproduce NAME`."""
