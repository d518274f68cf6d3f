"""Calibrations, classifications and predictions, as functions: files, arrays and options in, results that print and
show themselves out; and the results of what `deformscope.runs` drives.

`deformscope/__init__.py` exports what a script needs of both; `deformscope.cli` puts flags before and words after.
"""
