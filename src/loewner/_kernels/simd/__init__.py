"""Vectors in registers: types, arithmetic, memory, support search."""
