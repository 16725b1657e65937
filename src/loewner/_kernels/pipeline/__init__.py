"""Many pairs of bodies: lists, verdicts, distances."""
