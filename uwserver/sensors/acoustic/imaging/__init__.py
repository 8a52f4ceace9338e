"""What all imaging sonars need, arrays in and arrays out: rays, finer rays at thin things, echoes over range, speckle, beams and bins.

Nothing here knows a sensor or a world.
"""
