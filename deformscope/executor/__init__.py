"""One executor for everything that has many cases: in this process, in others of this machine, or on a Ray cluster."""
