"""How results are logged: a view for each type of result. The only place, with the recorder, that knows rerun."""
