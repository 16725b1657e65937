"""The lowest layer of the library's Python code, which all other modules share.

Arguments: `_validate`, `_plausible`, `_rotations`, `_matrices`. Files: `_files` and `_archives`; `_json`, `_nodes`,
`_tables` and `_xml` read text formats strictly. The machine: `_guard`, `_threads`, `_memory`, `_workspaces`, `_log`.
Numbers that have the same bits on every machine: `_elementary`, `_low_discrepancy`. Small helpers: `_kept`,
`_read_only`, `_proportions`, `_pictures`, `_outcomes`.
"""
