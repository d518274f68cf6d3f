"""How results are logged: a view for each type of result. Views and recording by rerun: only this package and the
recorder import it."""
