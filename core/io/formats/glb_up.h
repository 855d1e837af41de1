/* What says which axis of a cloud a binary glTF's node turned upwards.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_GLB_UP_H
#define WHITTLE_CORE_IO_FORMATS_GLB_UP_H

/* A member of the extras of a scene's only node: "x" or "z", which its matrix turned to glTF's y. */
#define GLB_UP_MARK "whittle_up"

#endif
