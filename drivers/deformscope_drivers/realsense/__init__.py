"""RealSense cameras through librealsense's Python module, in a process of its own: what reads `depth_camera.Realsense`.

process.py runs there; camera.py is a camera that was chosen, set and read back; advice.py is what the library's errors
mean. double.py stands in for the library. How the process is started and ends is in `hosted`. It
starts quickly: nothing imports numpy, and nothing imports the library but process.py.
"""
