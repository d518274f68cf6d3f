"""Cost of MSM on this machine: measured in one run. `python -m studies speed` compares it with NumPy and other engines.

`deformscope bench` shows it as a table. `python -m deformscope.bench --json -` needs only numpy, scipy and warp, for a
machine without the other packages. `bench_cases.py` says what is measured, `timing.py` how."""
