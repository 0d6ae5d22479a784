"""The kinds of figures: what each takes in a job, and the function that draws it."""
