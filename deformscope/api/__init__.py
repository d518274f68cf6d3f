"""What the commands compute, as functions: files, arrays and options in, results that print and show themselves out.

`deformscope/__init__.py` exports what a script needs of it; `deformscope.cli` puts flags before it and words after it.
"""
