"""Studies behind the claims in the documentation: how often intervals and verdicts hold, on data of known truth.

    python -m studies                    lists them
    python -m studies creep --objects 20 --json creep.json

No part of what is installed: it imports deformscope, and nothing of deformscope imports it. A study is one file here
that declares `STUDY`; the first line of its docstring is its line in the list.
"""
