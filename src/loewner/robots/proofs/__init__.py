"""Proofs of motions, and proofs that other programs verify.

`motions` settles motions along `courses`. `proofs`, `contacts`, `in_time` and `curves` determine the proven properties
of straight motions, their ends, motions among moving bodies, and curves. `contact_times`, `approaches` and `tracking`
find the first contact, the smallest distance, and the largest joint error that is still proven. `written_proofs`,
`separations`, `proof_models`, `pair_proofs` and `common_points` write proofs; `range_proofs` and `pair_ranges` prove
pairs over ranges of the joints.
"""
