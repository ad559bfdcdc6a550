"""Many runs, compared: what is to be run, running it, and one folder that shows what came out."""
