"""OpenNI2, in a process of its own: what reads the cameras of the package `depth_camera`.

process.py runs there; library.py is OpenNI2's C interface, camera.py a camera that is set and read back. Both processes
know messages.py. It starts quickly: nothing here imports numpy.
"""
