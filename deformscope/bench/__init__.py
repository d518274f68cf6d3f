"""Cost of MSM on this machine: measured in one run, compared with NumPy and installed other engines.

`deformscope bench` shows it as a table. `python -m deformscope.bench --json -` needs numpy, scipy and warp alone, for a
machine that has no more. `cases.py` says what is measured, `timing.py` how.
"""
