"""The explorer: a page with the map of a table's records and animations of some of them.

`explorer.py` writes the page, whose parts are in `page/`. `start_map.py` places the records,
`replay_groups.py` chooses which are animated (in maps of cells by `start_map.py`) and what is recorded of
them by run kind, `replays.py` simulates them, `animated_records.py` compares them with the table, and
`page_format.py` has the format of columns and motions on the page and prepares plotly.js.
"""
