"""What the process that reads a camera through a vendor's library, and the process that records, both know.

It starts quickly: nothing here imports numpy.
"""
