"""Controllers of legs that a model file declares: oscillators, their feedback, and targets of joints."""
