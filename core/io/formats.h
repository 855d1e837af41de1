/* Formats of clouds that are read: one table of them all.
 *
 * To add one: a file in core/io/formats/ that defines cloud_NAME_look and cloud_NAME_read (core/io/reader.h), and its
 * row here.  What is told of formats (--help, /v1/info, problem documents, what a refused file hears) is told from the
 * table; how much memory one takes is predicted as for lines of text, unless core/pipeline/memory.c knows its header.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_H
#define WHITTLE_CORE_IO_FORMATS_H

/* constant, name (of its functions), title in lists, what a file looks like, its forms as reports name them (commas
 * between).  A file is of the first row that takes it for its own: those that know theirs by a mark come first. */
#define CLOUD_FORMAT_ROWS(ROW)                                                                                         \
    ROW(TAR, tar, "tar archives of clouds", "a tar archive", "tar")                                                    \
    ROW(PLY, ply, "PLY", "PLY", "ply/ascii,ply/binary_little_endian,ply/binary_big_endian")                            \
    ROW(PCD, pcd, "PCD", "a PCD cloud", "pcd/ascii,pcd/binary,pcd/binary_compressed")                                  \
    ROW(LAS, las, "LAS, LAZ", "a LAS cloud", "las,laz")                                                                \
    ROW(E57, e57, "E57", "an E57 cloud", "e57")                                                                        \
    ROW(PTX, ptx, "PTX", "a PTX cloud", "ptx")                                                                         \
    ROW(GLB, glb, "binary glTF", "a binary glTF scene", "glb")                                                         \
    ROW(OFF, off, "OFF", "an OFF mesh", "off")                                                                         \
    ROW(OBJ, obj, "OBJ", "an OBJ mesh", "obj")                                                                         \
    ROW(STL, stl, "STL", "an STL mesh", "stl/ascii,stl/binary")                                                        \
    ROW(TEXT, xyz, "XYZ text", "text", "xyz")

#endif
