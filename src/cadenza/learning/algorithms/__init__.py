"""The algorithms that improve policies, a folder for each; see `cadenza.learning.learner`."""
