"""The kernels for Python: from the native library, or compiled on this machine."""
