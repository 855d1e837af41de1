/* Fuzzes the reader of binary glTF.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"
#include "tests/fuzz/fuzz_reader.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) { return fuzz_reader(cloud_glb_read, data, size); }
