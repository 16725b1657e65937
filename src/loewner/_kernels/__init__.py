"""Compiled kernels: scalars and arrays only; imports no other module of `loewner`."""
