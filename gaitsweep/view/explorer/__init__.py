"""The explorer: a page with the map of a table's records and animations of some of them.

`explorer.py` writes the page, whose parts are in `page/`. `start_map.py` places the records,
`page_columns.py` has their values; `traced_cells.py` chooses which are animated, `replay_groups.py` what is
recorded of them by run kind, `replays.py` and `section_starts.py` simulate them, and `encoding.py` packs
their motion.
"""
