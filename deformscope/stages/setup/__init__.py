"""Where things are to one another before anything is explored: table, tip, camera, force sensor, clocks."""
