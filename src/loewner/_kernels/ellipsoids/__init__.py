"""Two ellipsoids: contact function, near points, distances."""
