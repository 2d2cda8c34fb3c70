"""Free pressing with a force/torque sensor: a recording of minutes teaches a sensor its gel, its shear, and how both are aligned.

    pressing                what a recording delivers: images that can be read, samples, and which of them are stuck
    force_torque_alignment  wrenches by the images, samples ──▶ delay, rotation, origin, bias and drift
    known_pressing          contacts of a recording ──▶ presses with known loads, shear factor, cross-validation by contact

`force_calibration.calibrate_force` fits the gel to these presses together with those of a scale.
"""
