"""Cost of MSM on this machine: measured in one run. `python -m studies speed` compares it with NumPy and other engines.

`deformscope bench` shows it as a table. `bench_cases.py` says what is measured, `timing.py` how."""
