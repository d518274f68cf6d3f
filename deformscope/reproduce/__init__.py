"""The experiments of the thesis, in the laboratory: what `deformscope reproduce` computes."""
