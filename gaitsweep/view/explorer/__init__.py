"""The explorer: a page with the map of a table's records and animations of some of them.

`explorer.py` writes the page, whose parts are in `page/`. `start_map.py` places the records and chooses which
are animated, `replay_groups.py` what is recorded of them by run kind, `replays.py` simulates them, and
`page_format.py` has the format of columns and motions on the page and prepares plotly.js.
"""
