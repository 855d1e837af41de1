"""What the report says between its tables and pictures.  Names in braces are filled in with what was measured.

SPDX-License-Identifier: GPL-3.0-or-later
"""

TABLE_1 = """The paper's form of the DSO, one thread, medians of {repeats} runs. The DSO needs the neighbourhoods and
the normals, so their times stand beside it. The paper's own times are of another decade's machine and say nothing
beside these; what can be compared is how the time grows with the number of points."""

TABLE_2 = """S simplifies the cloud and reconstructs what is left; flipped, it also turns edges of the mesh so that it
lies nearer to the original points; refined, which is how whittle runs by default, it moves vertices to other original
points as well. R reconstructs all points (Tight Cocone) and then collapses edges of that mesh (CGAL's Garland-Heckbert)
to the same number of vertices. Peers is the fastest way to reconstruct first with what there is: whittle's Tight Cocone
or CGAL's advancing front of all points, whichever takes less time, then meshoptimizer, the fastest collapse of make
peers. Times are the shortest of {turns} runs, in turns with all others, without reading, writing and measuring; of R and
the peers without what a reconstruction alone doesn't need. With all threads, which is how whittle runs by default, the
collapses and the advancing front still take one. Processor time is of all threads together: it is the one to go by where
the machine does other things, too."""

TABLE_2_IMPROVEMENT = """Improvement is (time_R - time_S) / time_R, the mean of all rows. It also depends on how fast
the programs are written: time_R is mostly CGAL's collapse, time_S mostly whittle's contraction and reconstruction."""

TABLE_2_ERRORS = """The time is one side of it. Errors are means of both directions in 1e-4 of the diagonal. R knows the
connectivity of the full cloud and may move vertices. S makes {loss:.2f} times the error of R, flipped {flipped:.2f}
times, refined {refined:.2f} times, the peers' {peers:.2f} times (geometric means)."""

FIGURE_4 = """Colours are those of whittle's dso.ply. The paper's sums let neighbours on opposite sides cancel: where a
surface is a saddle, their DSO is small though the surface bends. The root mean square has no such blind spots."""

ERRORS = """All relative to the diagonal of the true model's bounding box, both directions against the true mesh. Max by
Metro is the Hausdorff distance as the program Metro samples it, relative to its own diagonal, which is longer, since
Metro inflates the box. Santa isn't at hand; only the paper's own figures are repeated."""

PAPER_ERRORS = """The paper calls its figure the relative mean error. It can hardly be one: the paper's formulas as they
stand, without any of whittle's refinements, make a mean error that is smaller than the paper's figure by a factor of
{means[0]:.0f} to {means[1]:.0f}. Held against our largest error, the paper's figures are {maxima[0]:.1f} to
{maxima[1]:.1f} times it. So they look like the largest error relative to the diagonal, the one figure that Metro prints
in relative terms. A largest error hangs on one worst triangle; it need not fall from one setting to the next as the
mean does. The paper doesn't say how wide its neighbourhoods are, nor how its Tight Cocone was done, and both matter."""

FIGURE_8 = """The DSO moves points from where the surface is flat to where it bends most. The quadrics alone do that
already, so the difference is one of degree. What it is worth in figures, make ablation measures."""
