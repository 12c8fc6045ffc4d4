"""Cameras, rasterisation, iso-surfaces, colour and shading, in plain torch.

Conventions, stated once and used everywhere:

* World: right-handed, Z up, as in Blender. The object lies in the box [-1, 1]^3.
* Camera: looks along its -Z axis, +Y is up (OpenGL and Blender). `c2w` maps camera to world coordinates.
* Image: row 0 is on top; pixel and texel centres lie at +0.5. `K` is in pixels.
* UV: u points right, v points up, both in [0, 1]; row 0 of an atlas is v = 1.
* Depth: distance along the view axis (not along the ray), world units, positive in front; infinity is background.
* Colour: linear Rec.709 with straight alpha inside the program; sRGB at file edges and at the input of networks.
* Shapes: B batch, V views, N vertices, F faces, T texels a side, C channels. Channels come first;
  (H, W, C) only at file edges.
"""
