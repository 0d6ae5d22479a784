"""Whether the guarantees of docs/reliability.md hold: each file measures one, and fails where it does not."""
