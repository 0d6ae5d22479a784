"""How text becomes a checked value: documents, numbers, strict models, and what is wrong with them."""
