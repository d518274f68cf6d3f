"""RealSense cameras through librealsense's Python module, in a process of its own: what reads `depth_camera.Realsense`.

process.py runs there; camera.py is a selected and configured camera; advice.py explains the library's errors. double.py
replaces the library. How the process is started and ends is in `hosted`. It starts quickly: nothing imports numpy, and
nothing imports the library but process.py.
"""
