"""The choice of integrator, estimator and samples for a scene and its derivatives, by measurement (docs/plan.md)."""
