"""OpenNI2 in a separate process, which reads the cameras of the package `depth_camera`.

process.py runs there; library.py is OpenNI2's C interface, camera.py a camera that is set and read back. How
the process is started and ends is in `hosted`. The process starts quickly: no module here imports numpy."""
