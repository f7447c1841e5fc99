"""Tables, figures and pages of a study and of a run."""
