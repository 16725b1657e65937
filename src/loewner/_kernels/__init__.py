"""Compiled kernels: scalars and arrays only; imports no other room of `loewner`."""
