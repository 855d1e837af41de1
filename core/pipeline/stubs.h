/* What is left of a tube that was cut at one end: a stub, a dent in the sheet at its other end or a spike on it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_STUBS_H
#define WHITTLE_CORE_PIPELINE_STUBS_H

#include "core/mesh/mesh.h"

/* middle: of each of the cuts of a closed mesh the two vertices in the middle of the discs that closed it
 * (core/mesh/cut.h).  Where on one side of a cut the disc and all triangles beside it are together over three times
 * as large as a lid across what they end at, they are taken out, and what is left open is closed by triangles
 * between its vertices.  No point is lost by that: each one on the disc's rim is on the other side of the cut, too.
 * The mesh stays closed and oriented, and vertices are numbered anew where it changes.  O(triangles).
 * STATUS_NO_MEMORY: the mesh is as it was. */
enum status stubs_leave_out(struct mesh *mesh, const uint32_t (*middle)[2], size_t cuts, unsigned threads) MUST_CHECK;

#endif
