"""Proofs of motions, and proofs that other programs verify.

`motions` settles motions along `courses`. `proofs` proves straight motions, `contacts` proves motions that begin or end
in contact, `in_time` proves motions among moving bodies, and `curves` proves curves. `contact_times` finds the first
contact, `approaches` the smallest distance, and `tracking` the largest joint error that is still proven.
`written_proofs`, `separations`, `proof_models`, `pair_proofs` and `common_points` write proofs; `range_proofs` and
`pair_ranges` prove pairs over ranges of the joints.
"""
