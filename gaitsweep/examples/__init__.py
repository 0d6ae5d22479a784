"""Small models, written as by a user, each with a job."""
