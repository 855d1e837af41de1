// The parameters of a job.  `make contract` writes this file from core/params.c.
//
// SPDX-License-Identifier: GPL-3.0-or-later

export interface Parameters {
  /** Keep floor(ratio x points) points; 0.1 where no goal is given. */
  ratio?: number;
  /** Keep exactly this many points, or all distinct ones where they are fewer. */
  points?: number;
  /** Keep as few points as a search finds with no input point farther than this from the result, as measured:
   *  from the mesh where one is made, else from the tangent plane at the nearest kept point; points that denoise
   *  drops aren't bounded, nor is how far the mesh is from all points where there are none; with ratio or points,
   *  whichever stops first; takes up to ten times as long. */
  max_deviation?: number;
  /** max_deviation as a fraction of the diagonal. */
  max_deviation_rel?: number;
  /** The share of the points that are to be within max_deviation: 0.999 lets one in a thousand be farther, so
   *  that a few places don't decide how many points are kept. Default 1.0. */
  deviation_share?: number;
  /** Keep no two points nearer to each other than this; of points that are, the more important one stays. Alone
   *  it keeps all that have this distance, with another goal at most as many. */
  spacing?: number;
  /** Deprecated, use max_deviation: remove points as long as the quadric error, which no output shows, stays
   *  below this; with ratio or points, whichever stops first. @deprecated */
  max_error?: number;
  /** Ratios, separated by commas: a cloud and a mesh of each, from one contraction, named cloud_RATIO.ply and
   *  mesh_RATIO.ply; cloud.ply and mesh.ply are of the largest ratio. */
  levels?: readonly (number)[];
  /** Before all else: only points within this box, x0,y0,z0,x1,y1,z1, or, where there are eight numbers and more,
   *  within this polygon, x,y,x,y,... (a triangle has its first corner twice). */
  crop?: readonly (number)[];
  /** Before all else: only points for which all these conditions hold, as class==2|6,intensity>100: a property of
   *  the input, ==, !=, <, <=, > or >=, and a number, or several with | between them; class, return and returns
   *  are known for classification, return_number and number_of_returns. */
  where?: readonly (string)[];
  /** Where the input was scanned from, as x,y,z: normals and surfaces with borders face it; without it what the
   *  file says of that is taken. */
  viewpoint?: readonly (number)[];
  /** true: clouds and meshes are written with a normal at each point, nx, ny, nz: the input's own where it has
   *  them and they fit its points, else computed, towards the side that the mesh has in front or, without one,
   *  all towards the outside or the viewpoint. Default false. */
  normals?: "false" | "true";
  /** What to write, separated by commas: the cloud as cloud.ply (cloud), cloud.xyz (xyz), cloud.pcd, cloud.las,
   *  cloud.laz; as a tree of points, 3D Tiles in tileset.3tz (tileset), COPC in cloud.copc.laz (copc); the mesh
   *  as mesh.ply (mesh), mesh.obj, mesh.stl, mesh.glb; report.json (report); dso.ply (dso) and error.ply (error),
   *  which show every original point with its discrete shape operator, its distance to the mesh; preview.png, a
   *  picture of before, after and deviation. */
  outputs?:
    readonly ("cloud" | "xyz" | "mesh" | "report" | "dso" | "error" | "cloud.pcd" | "mesh.obj" | "mesh.stl" |
    "mesh.glb" | "preview.png" | "cloud.las" | "cloud.laz" | "tileset" | "cloud.copc.laz" | "cloud.ply" |
    "cloud.xyz" | "mesh.ply" | "report.json" | "dso.ply" | "error.ply" | "pcd" | "obj" | "stl" | "glb" | "preview"
    | "las" | "laz" | "tileset.3tz" | "copc")[];
  /** Before all other steps: outliers drops points that belong to no surface; full also smooths the others along
   *  their normals and keeps edges: points are then written at their smoothed positions, with all else unchanged,
   *  and errors are measured from there; auto: outliers where they are many or scattered, full where noise is
   *  large against the distances between points, and nothing where neither is; noisy: for meshes alone, full
   *  where noise is so large that a surface of the points would be crumpled, as auto but for smoothing where it
   *  would have spikes of strays, and nothing of any other cloud; with max_deviation it moves none; all three
   *  drop what is in the file twice, as of scans that don't fit each other, unless deviations are bounded.
   *  Default noisy. */
  denoise?: "none" | "outliers" | "full" | "auto" | "noisy";
  /** subset: mesh vertices are original points; optimal: mesh vertices move freely for the lowest error; auto:
   *  optimal where the surface is the input's own faces (surface=given) without texture coordinates and seams,
   *  else subset. Default auto. */
  placement?: "subset" | "optimal" | "auto";
  /** Form of the discrete shape operator that weights the quadrics: rms (robust), sum (the paper's), none.
   *  Default rms. */
  dso?: "rms" | "sum" | "none";
  /** Exponent of the discrete shape operator in the weight; 1 is the paper's. Default 0.25. */
  dso_exponent?: number;
  /** Weight of a virtual triangle's plane: its area, or unit (the paper's). Default area. */
  area_weight?: "unit" | "area";
  /** Weight of the line quadric along the normal, which keeps flat regions evenly sampled. Default 0.003. */
  line_quadric?: number;
  /** Edges of attributes count as features, too, each with its weight, as rgb:0.2,intensity:0.1: a step by the
   *  whole range of an attribute of weight 1 counts as much as one by a tenth of the diagonal; rgb is red, green
   *  and blue. */
  weights?: readonly (string)[];
  /** Radius of the neighbourhood (Gopi's m) as a multiple of the distance to the nearest neighbour. Default 2.5. */
  neighbourhood?: number;
  /** Fewest neighbours of a point; three times as many where the cloud is noisy. Default 6. */
  neighbours_min?: number;
  /** Most neighbours of a point; three times as many where the cloud is noisy. Default 10. */
  neighbours_max?: number;
  /** How the surface is found through the kept points; tight: Tight Cocone with dense normals and consistent
   *  marking (after Dey and Goswami 2003); literal: Tight Cocone as published (Dey and Goswami 2003). Default
   *  tight. */
  reconstruction?: "tight" | "literal";
  /** What the points are of: closed: the skin of a solid, reconstructed as a closed mesh; open: sheets with
   *  borders, as scans of rooms and single views are; heightfield: one sheet seen from above, as terrain is;
   *  given: the input's own faces, whose edges are collapsed, with borders and seams of texture coordinates kept;
   *  auto: given where the input has faces, else found out from the points, and told in the report. Default auto. */
  surface?: "closed" | "open" | "heightfield" | "auto" | "given";
  /** simplify-first: the surface is reconstructed from the kept points; reconstruct-first: from more, and its
   *  edges are collapsed with the topology that it has; auto: the latter where it has borders, where walls are
   *  thinner than kept points are apart, along creases, and where vertices move freely (placement=optimal), as
   *  the report says. Default auto. */
  order?: "auto" | "simplify-first" | "reconstruct-first";
  /** Borders of a surface that is reconstructed as closed (surface=closed, which this implies): fill: the mesh is
   *  closed; keep: facets that no point supports are dropped; auto: fill where the surface is found to be closed.
   *  Default auto. */
  boundary?: "fill" | "keep" | "auto";
  /** Close the holes of a mesh with borders whose borders are at most this long; where the surface ends is no
   *  hole. */
  close_holes?: number;
  /** Attributes of a mesh's vertices: nearest: of the vertex's own point, or where it was moved freely of the
   *  nearest point; mean: numbers with fractions, colours and intensity averaged over all points that the vertex
   *  is nearest to. Default nearest. */
  attributes?: "nearest" | "mean";
  /** Refinement of the mesh against the original points: none, flips of edges, or full (vertices move too).
   *  Default full. */
  refine?: "none" | "flips" | "full";
  /** What the mesh is measured against: points, the input's own faces, or a reconstruction of the full cloud;
   *  auto takes the input's faces, and points where it has none, none with an area, or so many equally near ones
   *  that measuring would take too long; the report says which. Default auto. */
  reference?: "auto" | "points" | "faces" | "reconstruction";
  /** Encoding of PLY outputs. Default binary. */
  encoding?: "binary" | "ascii";
  /** Bits of each component of red, green and blue in outputs: 8, which all programs show; 16; or keep, as the
   *  input has them. Default 8. */
  colours?: "8" | "16" | "keep";
  /** Coordinates of cloud.pcd: float, 32 bits around an origin that the report tells where it isn't 0, or double,
   *  which PCL and most other programs can't read. Default float. */
  pcd_precision?: "float" | "double";
  /** First line of cloud.xyz: none, which all programs read; plain, the names of the columns; or hash, the same
   *  behind a #. Default none. */
  header?: "none" | "plain" | "hash";
  /** true: positions in mesh.glb and in tiles have 16 bits along each axis of their box, normals 8
   *  (KHR_mesh_quantization). Default false. */
  quantize?: "false" | "true";
  /** true: mesh.glb and tiles are compressed, for programs that read EXT_meshopt_compression. Default false. */
  meshopt?: "false" | "true";
  /** What the columns of a text input are, where its first line doesn't say so: names of the first ones in their
   *  order, - for one to leave out (-,x,y,z,intensity), or pairs of a name and a column's name or number
   *  (x:east,y:north,z:4). */
  columns?: readonly (string)[];
  /** Which properties of the points outputs have besides x, y and z, as rgb,intensity: all where it isn't given,
   *  or none; rgb is red, green, blue and alpha, normals nx, ny and nz; fields that LAS always has are 0 where
   *  they go. */
  properties?: readonly (string)[];
  /** Width of each of the three pictures in preview.png. Default 480. */
  preview_size?: number;
  /** Where preview.png is looked at from: 0 is the front, 90 the right side; without it the widest side, 30
   *  degrees from its right or left. */
  preview_azimuth?: number;
  /** How far from above preview.png is looked at: 0 is level, 90 straight down. Default 25.0. */
  preview_elevation?: number;
  /** Which axis of the input points upwards, in preview.png and in mesh.glb, whose node turns it to glTF's y
   *  without changing the coordinates; auto: y of glTF, z of what is flat, else y or z, whichever the points
   *  stand on. Default auto. */
  up?: "auto" | "x" | "y" | "z";
  /** Seed of the samples that the error is measured with. Default 0. */
  seed?: number;
  /** Threads to use; 0 takes all processors; results don't depend on it. Default 0. */
  threads?: number;
  /** Deprecated name of reconstruction. @deprecated */
  cocone?: "tight" | "literal";
  /** Deprecated name of up. @deprecated */
  preview_up?: "auto" | "x" | "y" | "z";
}
