"""How results are logged: a view for each type of result. The only package, with the recorder, that imports rerun."""
