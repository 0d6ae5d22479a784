"""The explorer: a page on which a click on a start of a table makes it walk."""
