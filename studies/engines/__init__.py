"""Other ways to compute what deformscope does, for comparisons of time: `python -m studies speed`."""
