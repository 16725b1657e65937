"""Links and joints of robots, the readers of files and models that describe them, and the bodies of links.

`robot` defines `Robot`, `assembly` joins several robots, `links` and `tree` describe joints, and `reaching` solves
inverse kinematics. `urdf`, `srdf`, `xacro_files`, `mjcf`, `drake` and `pinocchio` read robots; `exports` writes them.
`link_bodies`, `link_meshes` and `coal_shapes` make bodies of links. `pair_verdicts` records whether each pair of links
can ever collide, `watch` reports odd values, `other_models` converts configurations to and from the orders of other
libraries, and `xml_elements` reads XML elements with their line numbers.
"""
