"""RealSense cameras through librealsense's Python module in a separate process, which reads for
`depth_camera.Realsense`.

camera.py runs there: a selected and configured camera, and the library's errors; double.py replaces the library. How
the process is started and ends is in `hosted`. It starts quickly: no module imports numpy, and only `load` the
library."""
