# SPDX-License-Identifier: GPL-3.0-or-later
#
# A cloud larger than memory, its tiles beside each other on this machine:
#
#     make -f tiles.mk -j4 IN=survey.laz OUT=small.laz PARAMETERS='--ratio 0.01' MEMORY=4G
#
# Each of the -j processes takes MEMORY.  After a stop or a crash the same command goes on.  The folder SCRATCH stays;
# remove it at the end.

WHITTLE ?= whittle
SCRATCH ?= $(OUT).tiles
MEMORY ?= 4G
PARAMETERS ?= --ratio 0.1
THREADS ?= 1

.PHONY: all
all: $(OUT)

# The numbers of the tiles are known once there is a plan, so a second make runs them.
$(OUT): $(IN)
	$(WHITTLE) tiles plan $(IN) --scratch '$(SCRATCH)' --memory $(MEMORY) $(PARAMETERS)
	+$(MAKE) -f $(firstword $(MAKEFILE_LIST)) --no-print-directory tiles SCRATCH='$(SCRATCH)'
	$(WHITTLE) tiles merge '$@' --scratch '$(SCRATCH)' --force

.PHONY: tiles
tiles: $(if $(filter tiles,$(MAKECMDGOALS)),$(addprefix $(SCRATCH)/left.,$(shell $(WHITTLE) tiles list --scratch '$(SCRATCH)')))

$(SCRATCH)/left.%:
	$(WHITTLE) tiles run $* --scratch '$(SCRATCH)' --threads $(THREADS)
