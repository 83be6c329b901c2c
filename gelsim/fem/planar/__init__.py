"""Presses that reduce to a plane: bodies of revolution pressed along their axis, and plane strain.

Elements, assembly and contact of the plane behind the interfaces of the solid ones, so that Newton, the linear solver and the march of
`gelsim.fem` serve both; `recording` makes the surfaces of the whole body from the profile's.
"""
