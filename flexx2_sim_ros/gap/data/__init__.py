"""Recordings of a campaign, checked, with the pose and covariates of each."""
