"""From a reading to the wrench that the object applies to the skin: by physics, by learning, or by both.

    by physics     HeightMap ──gel compliance──▶ Traction ──▶ Wrench
    by learning    Rectified ──deformation──▶ Deformation ──network──▶ Wrench

An estimator answers one reading at a time (`estimator.ForceEstimator`); all are interchangeable.
"""
