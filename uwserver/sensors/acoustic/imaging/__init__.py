"""What every sonar that draws pictures is made of, arrays in, arrays out: a fan of rays, rays that are added where thin things stand, echoes over
range, speckle, and the bins. It knows no sensor and no world."""
