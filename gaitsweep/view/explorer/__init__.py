"""The explorer: a page on which a click on a start of a table shows the walking model."""
