"""One pair of pieces: certificate, GJK, expanding polytope, exact answer."""
