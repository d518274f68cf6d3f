"""OpenNI2 in a separate process, which reads the cameras of the package `depth_camera`.

camera.py runs there: a camera that is set and read back; library.py is OpenNI2's C interface. How the process is
started and ends is in `hosted`. It starts quickly: no module here imports numpy."""
