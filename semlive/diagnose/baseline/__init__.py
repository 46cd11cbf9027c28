"""The baseline model without further effects: observations, priors, whitening, Bayes factors."""
