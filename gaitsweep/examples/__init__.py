"""Small models that are written as a user would write them, each with a job beside it."""
