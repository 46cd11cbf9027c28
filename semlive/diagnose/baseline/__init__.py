"""The run without further effects: observations, priors, whitening, Bayes factors."""
