"""OpenNI2, in a process of its own: what reads the cameras of the package `depth_camera`.

process.py runs there; library.py is OpenNI2's C interface, camera.py a camera that is set and read back. What
both processes know is in `camera_process`. It starts quickly: nothing here imports numpy.
"""
