"""Estimation of the wrench that an object applies to the skin, from one reading: by physics or by a network.

    by physics     HeightMap ──gel compliance──▶ Traction ──▶ Wrench
    by learning    Rectified ──deformation──▶ Deformation ──network──▶ Wrench

All estimators implement `estimator_and_scale.ForceEstimator` and are interchangeable. `SensorFolder.estimator` builds one by
name, with the force scale of the sensor.
"""
