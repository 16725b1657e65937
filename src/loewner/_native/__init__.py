"""The kernels as Python calls them: from the native library, or compiled on this machine."""
