// SPDX-License-Identifier: GPL-3.0-or-later
// Two vessels of different diameters, end to end along z with a gap between them at z = 0.
// Lengths in millimetres. `make meshes` makes vessels.msh of it.
//
// Each vessel is a ring of triangles drawn out along z in layers that grow away from the gap, where
// the needle works: two elements through the wall, and as many tets as the paper's scene.

gap = 1.5;
length = 20;
wall = 1.5;
outer_radius() = {6, 5};  // proximal (z < 0), distal (z > 0)
around() = {30, 24};      // elements around each; a multiple of three
through = 2;              // elements through the wall
layers = 9;
growth = 1.12;            // of each layer over the one before

total = (growth ^ layers - 1) / (growth - 1);
For k In {1:layers}
  ones(k - 1) = 1;
  heights(k - 1) = ((growth ^ k - 1) / (growth - 1)) / total;
EndFor

For i In {0:1}
  side = 2 * i - 1;
  z = side * gap / 2;
  ring() = {};
  centre = newp; Point(centre) = {0, 0, z};
  For k In {0:2}
    angle = 2 * Pi * k / 3;
    in(k) = newp; Point(in(k)) = {(outer_radius(i) - wall) * Cos(angle), (outer_radius(i) - wall) * Sin(angle), z};
    out(k) = newp; Point(out(k)) = {outer_radius(i) * Cos(angle), outer_radius(i) * Sin(angle), z};
    spoke(k) = newl; Line(spoke(k)) = {in(k), out(k)};
  EndFor
  For k In {0:2}
    next = (k + 1) % 3;
    arc_in = newl; Circle(arc_in) = {in(k), centre, in(next)};
    arc_out = newl; Circle(arc_out) = {out(k), centre, out(next)};
    loop = newll; Curve Loop(loop) = {spoke(k), arc_out, -spoke(next), -arc_in};
    ring(k) = news; Plane Surface(ring(k)) = {loop};
    Transfinite Curve {arc_in, arc_out} = around(i) / 3 + 1;
    Transfinite Curve {spoke(k)} = through + 1;
    Transfinite Surface {ring(k)} Alternate;
  EndFor
  body() = {}; end() = {}; outer() = {}; lumen() = {};
  For k In {0:2}
    drawn() = Extrude {0, 0, side * length} { Surface{ring(k)}; Layers{ ones(), heights() }; };
    end() += drawn(0);
    body() += drawn(1);
    outer() += drawn(3);
    lumen() += drawn(5);
  EndFor
  If (i == 0)
    Physical Volume("proximal", 1) = body();
    Physical Surface("proximal_end", 11) = end();
    Physical Surface("proximal_rim", 12) = ring();
    Physical Surface("proximal_lumen", 13) = lumen();
    Physical Surface("proximal_outer", 14) = outer();
  Else
    Physical Volume("distal", 2) = body();
    Physical Surface("distal_end", 21) = end();
    Physical Surface("distal_rim", 22) = ring();
    Physical Surface("distal_lumen", 23) = lumen();
    Physical Surface("distal_outer", 24) = outer();
  EndIf
EndFor

Mesh.Optimize = 0;
General.NumThreads = 1;
