"""RealSense cameras through librealsense's Python module in a separate process, which reads for
`depth_camera.Realsense`.

process.py runs there; camera.py is a selected and configured camera; advice.py explains the library's errors. double.py
replaces the library. How the process is started and ends is in `hosted`. The process starts quickly: no module imports
numpy, and only process.py imports the library."""
