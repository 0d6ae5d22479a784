"""The papers whose models, figures and claims come with gaitsweep, each an extension like any other."""
