"""The experiments of the thesis, in the laboratory: computations of `deformscope reproduce`."""
