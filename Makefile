# SPDX-License-Identifier: GPL-3.0-or-later
#
# One Makefile, no recursion for building.  Objects and programs go to build/$(config)/.
# Sources are found by their place: core/ is libwhittle.a, api/ is libapi.a, server/cli/ is the program whittle,
# server/shared/ is in both programs, everything else of server/ is whittled (libserver.a, and daemon/main.c),
# tests/unit/test_*.c is a program each.

config ?= release
ifeq ($(filter $(config),release narrow scalar clang arm64 debug asan tsan cov fuzz),)
$(error config must be one of release, narrow, scalar, clang, arm64, debug, asan, tsan, cov, fuzz)
endif

build := build/$(config)
# make V=1 shows the commands.
Q := $(if $(V),,@)
say := $(if $(V),@:,@echo ' ')
PYTHON ?= /usr/bin/python3
OBJCOPY ?= objcopy
VERSION := $(shell deploy/version.sh)

# ---------------------------------------------------------------------------------------------------- flags
WARNINGS := -Wall -Wextra -Wshadow -Wconversion -Wvla
ifdef CI
WARNINGS += -Werror
endif
flags_release := -O2 -g
# As a processor without AVX2 runs it, on any; and without vectors (core/math/simd.h).
flags_narrow := $(flags_release)
flags_clang := $(flags_release)
flags_scalar := $(flags_release) -DSIMD_SCALAR
# Cross compiled against libraries that tests/tools/arm64.sh unpacks: the core, its unit tests, whittle.
sysroot := build/arm64/sysroot/usr
flags_arm64 := $(flags_release) $(addprefix -isystem $(sysroot)/include,/aarch64-linux-gnu /)
flags_debug := -O0 -g3
# Line numbers are what a report needs; all of -g takes a third longer to compile.
flags_asan := -O1 -g1 -fsanitize=address,undefined -fno-sanitize-recover=undefined -fno-omit-frame-pointer
flags_tsan := -O1 -g -fsanitize=thread
# Counters that threads share are added to as one, or they go astray, below zero too, which gcovr refuses.
flags_cov := -Og -g --coverage -fprofile-update=atomic
flags_fuzz := -O1 -g -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=undefined
ifneq ($(filter $(config),fuzz clang),)
CC := clang
CXX := clang++
endif
COMMON := $(flags_$(config)) -I. -MMD -MP -pthread -fno-math-errno -ffp-contract=off -fstack-protector-strong
# gcc 12 for arm64 ends with an internal error where it vectorises some reductions by itself; ours are written as vectors.
COMMON += $(if $(findstring aarch64,$(shell $(CC) -dumpmachine 2>&1)),-fno-tree-vectorize)
override CFLAGS += -std=c11 -D_GNU_SOURCE $(COMMON) $(WARNINGS) -Wstrict-prototypes
override CXXFLAGS += -std=c++17 $(COMMON) -Wall -Wextra -Wshadow -DCGAL_NDEBUG -frounding-math
override LDFLAGS += $(filter -fsanitize% --coverage,$(flags_$(config))) -pthread \
    $(if $(filter arm64,$(config)),-L$(sysroot)/lib/aarch64-linux-gnu \
        $(foreach at,$(sysroot) $(sysroot)/..,-Wl$(comma)-rpath-link=$(at)/lib/aarch64-linux-gnu))

CODEC_LIBS := -lz -lzstd
CORE_LIBS := -lpng -lexpat -ljansson -llz4 -lgmp -lmpfr -lstdc++ $(CODEC_LIBS) -lm
API_LIBS := -ljansson
DAEMON_LIBS := -lpq -lcurl -lmicrohttpd -lsqlite3 -lnettle -lgnutls

# ---------------------------------------------------------------------------------------------------- sources
rooms = $(foreach depth,* */* */*/*,$(wildcard $(1)/$(depth)$(2)))
# What the method is by the paper, for tests to measure it against: in no library.
reference_src := $(wildcard core/simplify/reference/*.c)
core_src := $(filter-out $(reference_src),$(call rooms,core,.c)) $(call rooms,core,.cc)
api_src := $(call rooms,api,.c)
cli_src := $(wildcard server/cli/*.c)
daemon_main := server/daemon/main.c
server_src := $(filter-out $(cli_src) $(daemon_main),$(call rooms,server,.c))
all_unit_src := $(wildcard tests/unit/test_*.c)
# UNITS="formats laz" has these alone built and run.
unit_src := $(if $(UNITS),$(UNITS:%=tests/unit/test_%.c),$(all_unit_src))
instant_service := tests/unit/instant_service
unit_support_src := $(filter-out $(all_unit_src) $(instant_service).c,$(wildcard tests/unit/*.c)) $(reference_src)
# Unit tests of core/ that need nothing of api/ and server/.
service_fixtures := $(shell grep -lE '"(api|server)/' tests/unit/*.h) $(addprefix tests/unit/,faults.h instant_service.h)
core_unit_src := $(shell grep -LF -e '"api/' -e '"server/' $(patsubst %,-e '"%"',$(service_fixtures)) $(unit_src))
ifeq ($(config),arm64)
server_src := $(wildcard server/shared/*.c)
unit_src := $(core_unit_src)
unit_support_src := tests/unit/dense.c tests/unit/folder.c tests/unit/shapes.c $(reference_src)
DAEMON_LIBS :=
endif
tool_src := $(wildcard tests/tools/*.c tests/tools/*.cc tests/bench/*.c tests/bench/*.cc)
fuzz_src := $(wildcard tests/fuzz/fuzz_*.c)
peer_src := $(wildcard tests/peers/*.cc)
comma := ,
object = $(patsubst %,$(build)/%.o,$(basename $(1)))

# Compiled once more for processors with AVX2, which is chosen while the program is loaded (core/base/processor.h).
kernel_src := core/math/few.c core/clean/around.c core/math/sym3.c core/mesh/edge_costs.c \
    core/spatial/directions.c core/spatial/knn_boxes.c core/spatial/knn_group.c core/surface/sheet/rays.c \
    $(addprefix core/simplify/,pair_cost.c quadric.c rank_sort.c) $(addprefix core/refine/,assign.c local_delaunay.c) $(wildcard core/refine/kernels/*.c)
has_choice := $(if $(filter release clang debug cov,$(config)),\
    $(shell $(CC) $(filter-out -MMD -MP,$(CFLAGS)) -dM -E - < /dev/null | grep -w __x86_64__))
kernel_obj := $(call object,$(kernel_src))
wide_obj := $(if $(has_choice),$(kernel_obj:.o=.avx2.o))
twin_obj := $(kernel_obj:.o=.scalar.o)
# whittle as config=narrow and config=scalar build it, of release's objects but for those in which these differ: what
# is chosen, and what has vectors (core/math/simd.h).
simd_headers := core/math/simd.h $(shell grep -rlF '"core/math/simd.h"' core --include='*.h')
simd_src := $(shell grep -rlF $(patsubst %,-e '"%"',$(simd_headers)) core --include='*.c')
narrow_obj := $(patsubst %.c,$(build)/forms/narrow/%.o,$(kernel_src))
scalar_obj := $(patsubst %.c,$(build)/forms/scalar/%.o,$(sort $(kernel_src) $(simd_src)))
form_programs := $(if $(has_choice),$(build)/forms/narrow/whittle $(build)/forms/scalar/whittle)
core_obj = $(call object,$(core_src)) $(wide_obj)
objects_first = $(filter %.o,$^) $(filter %.a,$^)

libwhittle := $(build)/libwhittle.a
libapi := $(build)/libapi.a
libserver := $(build)/libserver.a
programs := $(build)/whittle $(build)/whittled
unit_programs := $(patsubst tests/unit/%.c,$(build)/tests/unit/%,$(unit_src))
fuzz_programs := $(patsubst %.c,$(build)/%,$(fuzz_src))
tool_programs := $(addprefix $(build)/,$(basename $(filter-out %/confined_probe.c,$(tool_src))))
peer_programs := $(addprefix $(build)/,$(basename $(peer_src)))

# ---------------------------------------------------------------------------------------------------- targets
.PHONY: all
all: $(call object,$(filter %.cc,$(core_src))) $(programs) ## build whittle and whittled (the default); config=release|debug|asan|tsan
.DEFAULT_GOAL := all

.PHONY: help
help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## */\1\t/' | expand -t 18

$(build)/%.o: %.c
	@mkdir -p $(@D)
	$(say) CC $<
	$(Q)$(CC) $(CFLAGS) $(CPPFLAGS) -c -o $@ $<

$(build)/%.o: %.cc
	@mkdir -p $(@D)
	$(say) CXX $<
	$(Q)$(CXX) $(CXXFLAGS) $(CPPFLAGS) -c -o $@ $<

$(kernel_obj): private override CPPFLAGS += $(if $(has_choice),-DKERNEL_CHOICE)
# Sanitizers can't start before the choice, so they look at the form that this machine would choose.
$(kernel_obj): private override CPPFLAGS += $(if $(filter asan fuzz,$(config)),\
    $(shell grep -qw avx2 /proc/cpuinfo && echo -mavx2))
$(build)/%.avx2.o: private override CPPFLAGS += -mavx2 -DKERNEL_AVX2
$(build)/%.avx2.o: %.c
	@mkdir -p $(@D)
	$(say) CC $< for AVX2
	$(Q)$(CC) $(CFLAGS) $(CPPFLAGS) -c -o $@ $<

# The scalar form beside the others, for the unit tests.
$(build)/%.scalar.o: private override CPPFLAGS += -DSIMD_SCALAR -DKERNEL_TWIN
$(build)/%.scalar.o: %.c
	@mkdir -p $(@D)
	$(say) CC $< without vectors
	$(Q)$(CC) $(CFLAGS) $(CPPFLAGS) -c -o $@ $<

$(libwhittle): $(core_obj)
$(libapi): $(call object,$(api_src))
$(libserver): $(call object,$(server_src))
$(libwhittle) $(libapi) $(libserver):
	@mkdir -p $(@D)
	@rm -f $@
	$(Q)$(AR) rcs $@ $^

# The library as others link it.  The soname counts incompatible changes of core/whittle.h.  In the archive that is
# installed everything else is local too, so that its names can't collide with a program's own.
SONAME := libwhittle.so.0
libwhittle_so := $(build)/$(SONAME)
$(libwhittle_so): $(core_obj) core/library/libwhittle.map
	$(say) LD $@
	$(Q)$(CC) $(LDFLAGS) -shared -Wl,-soname,$(SONAME) -Wl,--version-script=core/library/libwhittle.map \
	    -Wl,--no-undefined -Wl,-z,relro,-z,now -o $@ $(objects_first) $(CORE_LIBS)

whittle_a := $(build)/installed/libwhittle.a
$(whittle_a): $(core_obj)
	@mkdir -p $(@D)
	$(say) AR $@
	$(Q)$(LD) -r -o $(@D)/whittle.o $^ && $(OBJCOPY) --localize-hidden $(@D)/whittle.o
	@rm -f $@
	$(Q)$(AR) rcs $@ $(@D)/whittle.o

.PHONY: library
library: $(libwhittle_so) $(whittle_a) ## build libwhittle.so and libwhittle.a, which core/whittle.h describes

$(build)/whittle: $(call object,$(cli_src)) $(libserver) $(libapi) $(libwhittle)
	$(say) LD $@
	$(Q)$(CC) $(LDFLAGS) -o $@ $^ $(API_LIBS) $(CORE_LIBS)

$(build)/whittled: $(call object,$(daemon_main)) $(libserver) $(libapi) $(libwhittle)
	$(say) LD $@
	$(Q)$(CC) $(LDFLAGS) -o $@ $^ $(API_LIBS) $(DAEMON_LIBS) $(CODEC_LIBS) -lseccomp -lm

$(build)/tests/unit/test_service_faults $(build)/tests/fuzz/fuzz_http: $(build)/$(instant_service).o

$(build)/tests/unit/test_kernels: $(twin_obj)
$(build)/tests/unit/test_kernels.o: private override CPPFLAGS += $(if $(has_choice),-DKERNEL_CHOICE)

$(build)/forms/scalar/%.o: private override CPPFLAGS += -DSIMD_SCALAR
$(narrow_obj): $(build)/forms/narrow/%.o: %.c
$(scalar_obj): $(build)/forms/scalar/%.o: %.c
$(narrow_obj) $(scalar_obj):
	@mkdir -p $(@D)
	$(say) CC $< for $@
	$(Q)$(CC) $(CFLAGS) $(CPPFLAGS) -c -o $@ $<

$(build)/forms/narrow/whittle: $(narrow_obj)
$(build)/forms/scalar/whittle: $(scalar_obj)
$(form_programs): $(call object,$(cli_src)) $(libserver) $(libapi) $(libwhittle)
	$(say) LD $@
	$(Q)$(CC) $(LDFLAGS) -o $@ $(objects_first) $(API_LIBS) $(CORE_LIBS)

# Unit tests can make each allocation fail (tests/unit/faults.c).
wrapped := $(if $(filter arm64,$(config)),,$(patsubst %,-Wl$(comma)--wrap=%,malloc aligned_alloc calloc realloc reallocarray strdup strndup _Znwm))
$(unit_programs): $(build)/tests/unit/%: $(build)/tests/unit/%.o $(call object,$(unit_support_src)) \
    $(libserver) $(libapi) $(libwhittle)
	$(say) LD $@
	$(Q)$(CC) $(LDFLAGS) $(wrapped) -o $@ $(objects_first) -lcmocka $(API_LIBS) $(DAEMON_LIBS) $(CORE_LIBS)

$(tool_programs): $(build)/%: $(build)/%.o $(libapi) $(libwhittle)
	$(say) LD $@
	$(Q)$(CC) $(LDFLAGS) -o $@ $^ $(API_LIBS) $(CORE_LIBS)

# The probe is confined as whittle is, which sanitizers can't stand.
confined_probe_obj := $(addprefix $(build)/tests/tools/,confined_probe.o confined_no_new_code.o)
$(confined_probe_obj): override CFLAGS := $(filter-out -fsanitize% --coverage,$(CFLAGS))
$(build)/tests/tools/confined_no_new_code.o: server/cli/no_new_code.c
	$(say) CC $<
	@mkdir -p $(@D)
	$(Q)$(CC) $(CFLAGS) $(CPPFLAGS) -c -o $@ $<
$(build)/tests/tools/confined_probe: $(confined_probe_obj)
	$(say) LD $@
	$(Q)$(CC) -pthread -o $@ $^

# Each peer has libraries of its own; their headers are not ours to warn about.
peer_cflags = $(subst -I/,-isystem /,$(filter-out -std=%,$(shell pkg-config --cflags $(1))))
$(build)/tests/peers/%_cgal.o: override CXXFLAGS += -isystem /usr/include/eigen3 \
    -DCGAL_EIGEN3_ENABLED -DCGAL_LINKED_WITH_TBB
$(build)/tests/peers/%_cgal: peer_libs = -ltbb -lgmp -lmpfr
$(build)/tests/peers/points_pcl.o: override CXXFLAGS += $(call peer_cflags,pcl_filters)
$(build)/tests/peers/points_pcl: peer_libs = -lpcl_filters -lpcl_search -lpcl_common
$(build)/tests/peers/open3d.o: override CXXFLAGS += -isystem /usr/include/eigen3 $(call peer_cflags,Open3D)
$(build)/tests/peers/open3d: peer_libs = -lOpen3D
$(build)/tests/peers/meshoptimizer: peer_libs = -lmeshoptimizer
$(build)/tests/peers/distances: peer_libs = -lgmp -lmpfr
$(peer_programs): $(build)/%: $(build)/%.o
	$(CXX) $(LDFLAGS) -o $@ $^ $(peer_libs)

# The shared library shows whittle_* of core/whittle.h alone; the same objects are in libwhittle.a.
$(core_obj) $(twin_obj) $(narrow_obj) $(scalar_obj): override CFLAGS += -fPIC -fvisibility=hidden
$(call object,$(core_src)): override CXXFLAGS += -fPIC -fvisibility=hidden -fvisibility-inlines-hidden

# What takes the time of a job.
ifneq ($(filter $(config),release narrow scalar clang arm64),)
$(core_obj) $(twin_obj) $(narrow_obj) $(scalar_obj): override CFLAGS += -O3
endif

# The contract is written in parts.
contract_parts := $(wildcard $(addprefix api/openapi/,*.json paths paths/*.json components components/*.json))
contract := $(build)/api/openapi/openapi.json
$(contract): api/openapi/parts.py $(contract_parts)
	@mkdir -p $(@D)
	$(say) JOIN $@
	$(Q)$(PYTHON) api/openapi/parts.py api/openapi $@

# Files that are compiled into the program.
$(build)/api/openapi/openapi.o: $(contract)
$(build)/api/openapi/openapi.o: override CFLAGS += -DOPENAPI_JSON='"$(contract)"'
page := $(wildcard build/page/files.h)
$(build)/server/handlers/page.o: server/page/plain.html $(page) $(build)/page.stamp
$(build)/server/handlers/page.o: private override CPPFLAGS += $(if $(page),-include $(page))
$(build)/page.stamp: FORCE
	@mkdir -p $(@D)
	@cat /dev/null $(wildcard build/page/index.html) | cmp -s - $@ || cat /dev/null $(wildcard build/page/index.html) > $@

# The version is compiled into one file, rebuilt when it changes.
$(build)/core/base/version.o: override CFLAGS += -DWHITTLE_VERSION='"$(VERSION)"'
$(build)/core/base/version.o: $(build)/version.stamp
$(build)/version.stamp: FORCE
	@mkdir -p $(@D)
	@echo '$(VERSION)' | cmp -s - $@ || echo '$(VERSION)' > $@
FORCE:

# The page at / takes two packages from npm, by their lock file; without it the service has a plain page.
.PHONY: page page-files
page: page-files ## fetch what the page takes from npm, put the page together, and build whittled with it (Node 18 or newer)
	@$(MAKE) --no-print-directory all
page-files: # the page alone, for whoever builds afterwards
	@command -v npm > /dev/null || deploy/deps.sh nodejs npm
	@cd server/page && npm ci --no-audit --no-fund --ignore-scripts
	@node server/page/build.mjs server/page build/page

# ---------------------------------------------------------------------------------------------------- set-up
# What building, testing and the demo want, by the names of Debian 12's packages.
packages := gcc g++ make git pkg-config libc6-dev libflann-dev libcgal-dev libgmp-dev libmpfr-dev libjansson-dev \
            libmicrohttpd-dev libgnutls28-dev libcurl4-openssl-dev libsqlite3-dev libpq-dev libseccomp-dev nettle-dev zlib1g-dev libpng-dev \
            libzstd-dev liblz4-dev libexpat1-dev libcmocka-dev libfaketime xz-utils zstd sqlite3 procps curl jq python3 \
            python3-pytest python3-pytest-xdist python3-jsonschema python3-numpy python3-scipy ca-certificates clang-format
peers_packages := libeigen3-dev libtbb-dev libpcl-dev libopen3d-dev libmeshoptimizer-dev meshlab xvfb xauth
bench_packages := valgrind
paper_packages := libeigen3-dev libtbb-dev libmeshoptimizer-dev python3-matplotlib
real_scans_packages := libeigen3-dev libtbb-dev libopen3d-dev python3-matplotlib python3-scipy
cluster_packages := postgresql-15 ceph-mon ceph-mgr ceph-osd radosgw nginx-light iproute2
fuzz_packages := clang libclang-rt-14-dev
contract_packages := chromium zsh fish libsixel-bin nginx-light openssl wget zstd groff $(if $(shell command -v npm),,nodejs npm)

.PHONY: deps
deps: ## install the Debian packages that are missing (root, or sudo)
	@deploy/deps.sh $(packages)

# ---------------------------------------------------------------------------------------------------- use
CLOUD ?=
RATIO ?= 0.1
LISTEN ?= 127.0.0.1:8080
DATA ?= $(HOME)/.local/share/whittled

.PHONY: demo
demo: deps ## upload a real scan to a daemon of its own and show what comes back; CLOUD=file.ply RATIO=0.1; HOSTS=3: to a cluster
	@$(if $(HOSTS),deploy/deps.sh $(cluster_packages))
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@$(if $(HOSTS),$(cluster_demo),tests/demo/demo.sh $(build) out '$(CLOUD)' '$(RATIO)')

# In network namespaces of this machine, as root; see tests/cluster/demo.py.
HOSTS ?=
cluster_demo = mkdir -p out && { [ -n '$(CLOUD)' ] || tests/demo/scan.sh armadillo out/armadillo.xyz; } && \
    WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -B tests/cluster/demo.py out "$(or $(CLOUD),out/armadillo.xyz)" \
    --hosts $(HOSTS) --ratio $(RATIO)

.PHONY: picture
picture: deps ## draw the picture of the README again -> .github/preview.png
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@mkdir -p out && tests/demo/scan.sh armadillo out/armadillo.xyz
	@$(build)/whittle out/armadillo.xyz --outputs mesh,preview.png --preview-size 200 --preview-azimuth 200 -q -o out
	@cp out/preview.png .github/preview.png

.PHONY: run
run: deps ## start whittled for use; LISTEN=127.0.0.1:8080 DATA=folder
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@mkdir -p '$(DATA)'
	$(build)/whittled --listen '$(LISTEN)' --data '$(DATA)'

# ---------------------------------------------------------------------------------------------------- checks
.PHONY: test
test: deps ## build and run all tests; also with config=asan or tsan
	@$(MAKE) --no-print-directory -j$$(nproc) all tests library
	@$(MAKE) --no-print-directory -j$$(nproc) lint test-unit
	@$(MAKE) --no-print-directory test-integration

.PHONY: test-long
test-long: ## make test with every value at every byte of the formats' fixtures; also with config=asan
	@WHITTLE_LONG=1 $(MAKE) --no-print-directory test

# What files, requests and failing disks can bring about.  The method has its turn in `make test config=asan`, which takes
# twice as long: what it makes of points, figures, parameters and everything that computes for long.
hostile := access attributes batches cli clouds config crash cross_site faults formats given hostile_store http idempotency intake join \
           laz leaving limits matrix mutations odd preview refusals service storage threads tls uploads webhooks worker
left_to_asan := accuracy bvh decimate deviation denoise exact eye gallery kernels measures metro mincut noise pair_cost peers \
                picture radix rank_sort refine refine_open sample_batch samples sheet sheets
.PHONY: test-hostile
test-hostile: deps ## what CI runs under the sanitizers: readers, HTTP, uploads, jobs' processes, failing disks, what fuzzers begin with
	@$(MAKE) --no-print-directory config=asan hostile-programs-and-tests UNITS='$(filter-out $(left_to_asan),$(patsubst tests/unit/test_%.c,%,$(all_unit_src)))'

.PHONY: hostile-programs-and-tests
hostile-programs-and-tests:
	@$(MAKE) --no-print-directory -j$$(nproc) all tests
	@$(MAKE) --no-print-directory -j$$(nproc) test-unit
	@$(MAKE) --no-print-directory test-integration INTEGRATION='$(hostile:%=test_%.py)'

.PHONY: tests
tests: $(unit_programs) $(fuzz_programs) $(tool_programs) $(build)/tests/tools/confined_probe \
    $(if $(filter release,$(config)),$(form_programs)) ## build the programs that the tests run

.PHONY: core-units
core-units: $(addprefix $(build)/,$(basename $(core_unit_src)))

.PHONY: test-arm64
test-arm64: ## the core's unit tests for arm64 under qemu, and whether whittle writes there what it writes here
	@tests/tools/arm64.sh

# What is ours to lay out: all but what fixtures bring along.
laid_out = $(shell find core api server tests \( -path tests/fixtures -o -name node_modules \) -prune -o \
    -name '*.[ch]' -print -o -name '*.cc' -print)

.PHONY: lint
lint: $(libwhittle) ## check layers, banned functions, licence lines, the layout of the code, and what documents and comments name
	@$(PYTHON) tests/lint/layers.py $(libwhittle)
	@$(PYTHON) -B tests/lint/documents.py
	@$(PYTHON) -B tests/lint/comments.py
	@command -v clang-format > /dev/null || deploy/deps.sh clang-format
	@clang-format --dry-run -Werror $(laid_out)

.PHONY: statistics
statistics: ## how many functions in a thousand lines, how long, how many used once; STATISTICS="folder ..."
	@$(PYTHON) tests/tools/statistics.py $(STATISTICS)

AGAIN ?= 0
BACKEND ?=
.PHONY: test-integration
INTEGRATION ?= .
test-integration: ## the integration tests alone, with the programs that are there, or INTEGRATION="test_http.py ..."; AGAIN=3 gives so many a second try; BACKEND=hosts: on PostgreSQL and Ceph's S3
	@$(if $(filter hosts,$(BACKEND)),deploy/deps.sh $(cluster_packages))
	@$(if $(filter hosts,$(BACKEND)),WHITTLE_BACKEND=hosts POSTGRES_OPTIONS='-c max_connections=1000' \
	    tests/tools/with_postgres.sh tests/tools/with_s3.sh env) WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -q -rs -p no:cacheprovider -n 4 --dist loadfile --again=$(AGAIN) \
	    --allowed-skips=tests/integration/skips.txt $(addprefix tests/integration/,$(INTEGRATION))

.PHONY: test-cluster
test-cluster: deps ## what several hosts share, on PostgreSQL and on Ceph's S3: contract suites, hosts beside each other, ROUNDS=5 of faults (SEED=1)
	@deploy/deps.sh $(cluster_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all tests
	@tests/tools/with_postgres.sh tests/tools/with_s3.sh $(MAKE) --no-print-directory cluster-tests
	@$(MAKE) --no-print-directory cluster-rounds

.PHONY: cluster-tests
cluster-tests:
	@for t in $(filter %/test_blobs,$(unit_programs)) $(filter %/test_catalog_%,$(unit_programs)); do \
	    echo "  TEST $$t"; $$t || exit; done
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -q -rs -p no:cacheprovider -n 2 \
	    $(addprefix tests/integration/,test_hosts.py test_rules.py test_hostile_store.py test_hosts_backup.py test_hosts_deploy.py test_transfer.py)

# A cluster in network namespaces, as root.  FAULTS=kill-host,cut-primary draws among these alone.
given = $(filter command% environment%,$(origin $(1)))
.PHONY: cluster-rounds
cluster-rounds:
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -B tests/cluster/rounds.py --rounds $(if $(call given,ROUNDS),$(ROUNDS),5) \
	    $(if $(call given,SEED),--seed $(SEED)) $(if $(FAULTS),--faults $(FAULTS)) $(if $(GRACE),--grace $(GRACE))

ROUNDS ?= 500
SEED ?= 1
.PHONY: test-crash
test-crash: deps ## kill service and workers in ROUNDS=500 rounds at named and random moments (SEED=1), and look
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) tests/integration/crash.py --rounds $(ROUNDS) --seed $(SEED)

REFERENCE ?=
.PHONY: same-bits
same-bits: deps ## whether whittle writes the same bits in release, narrow and scalar; REFERENCE=another whittle
	@for c in release narrow scalar; do $(MAKE) --no-print-directory -j$$(nproc) config=$$c build/$$c/whittle || exit; done
	@$(PYTHON) tests/tools/same_bits.py $(REFERENCE) build/release/whittle build/narrow/whittle build/scalar/whittle

MUTANTS ?= *
.PHONY: mutants
mutants: deps ## plant faults by hand, one at a time, and see a test find each; MUTANTS='fsync-*,webhook-*' picks some
	@deploy/deps.sh $(page_packages)
	@$(MAKE) --no-print-directory config=release page
	@cd tests/page && npm ci --no-audit --no-fund --ignore-scripts
	@$(MAKE) --no-print-directory config=release -j$$(nproc) all tests
	@$(PYTHON) tests/mutants/run.py -j $$(nproc) --pick '$(MUTANTS)' build/release

# Tests that fail don't take the figure away: it is printed, and then the target fails.
.PHONY: coverage
coverage: deps ## which lines and branches the tests run, a figure for each room -> build/cov/coverage.txt, .html; INTEGRATION="test_http.py ..." or none
	@deploy/deps.sh gcovr
	@$(MAKE) --no-print-directory config=cov -j$$(nproc) all tests
	@$(PYTHON) tests/tools/coverage.py --clean build/cov
	@failed=0; \
	$(MAKE) --no-print-directory -k config=cov -j$$(nproc) test-unit || failed=1; \
	$(if $(filter none,$(INTEGRATION)),,$(MAKE) --no-print-directory config=cov test-integration || failed=1;) \
	gcovr -r . --object-directory build/cov -f core/ -f api/ -f server/ --txt build/cov/coverage.txt \
	    --html-details build/cov/coverage.html --print-summary && \
	$(PYTHON) tests/tools/coverage.py build/cov/coverage.txt && exit $$failed

# ---------------------------------------------------------------------------------------------------- figures
.PHONY: bench
bench: deps ## time of each stage, memory, threads, peers; BENCH="--large --peers --save-ratios ..."
	@$(if $(findstring --peers,$(BENCH)),deploy/deps.sh libeigen3-dev libtbb-dev libopen3d-dev)
	@$(MAKE) --no-print-directory -j$$(nproc) all tools $(if $(findstring --peers,$(BENCH)),\
	    $(addprefix $(build)/tests/peers/,points_cgal surface_cgal open3d))
	@$(PYTHON) tests/bench/bench.py $(build) $(BENCH)

.PHONY: overhead
overhead: deps ## what the service costs beside the work, against nginx: requests a second, uploads, downloads
	@deploy/deps.sh nginx-light wrk
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@$(PYTHON) tests/bench/overhead.py $(build)

.PHONY: bench-catalog
bench-catalog: deps ## what PostgreSQL spends on a claim and a report with 10000 jobs waiting, and on idle hosts; HOSTS=100
	@deploy/deps.sh postgresql-15
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@POSTGRES_FSYNC=on POSTGRES_OPTIONS='-c max_connections=1000 -c shared_preload_libraries=pg_stat_statements' \
	    tests/tools/with_postgres.sh $(PYTHON) tests/bench/catalog.py $(build) --hosts $(or $(HOSTS),100)

.PHONY: bench-hosts
bench-hosts: deps ## throughput of three hosts of half a core each against one, a trivial job's time on PostgreSQL and S3 (root)
	@deploy/deps.sh $(cluster_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -B tests/cluster/bench.py $(BENCH)

.PHONY: bench-counts
bench-counts: deps ## instructions of each stage against the stored ones; BENCH=--save stores them
	@deploy/deps.sh $(bench_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all tools
	@$(PYTHON) tests/bench/counts.py $(build) $(BENCH)

.PHONY: bench-huge
bench-huge: deps ## a cloud larger than memory, POINTS=10000000: time, memory, disk, seams, error; BENCH="--memory 4G --real CLOUD"
	@$(MAKE) --no-print-directory -j$$(nproc) all tools
	@$(PYTHON) tests/bench/huge.py $(build) $(POINTS) $(BENCH)

.PHONY: bench-tileset
bench-tileset: deps ## a tileset of more points than memory holds, POINTS=20000000: time, memory, errors, gltf-validator, a viewer; BENCH="--memory 1G --show out"
	@$(MAKE) --no-print-directory -j$$(nproc) all tools
	@$(PYTHON) tests/bench/tileset.py $(build) $(POINTS) $(BENCH)

POINTS ?= 1000000
.PHONY: sizing
sizing: deps ## the table of deploy/README.md: processor, memory, disk for each million points; POINTS=1000000
	@$(MAKE) --no-print-directory -j$$(nproc) all tools
	@$(PYTHON) tests/bench/sizing.py $(build) $(POINTS)

.PHONY: accuracy
accuracy: deps ## the error tables of tests/bench/README.md; MESHES="mesh.ply ..." for others than Horse and Venus
	@$(MAKE) --no-print-directory -j$$(nproc) all $(build)/tests/peers/distances
	@$(PYTHON) tests/bench/accuracy.py $(build) $(MESHES)

.PHONY: odd-geometries
odd-geometries: deps ## time and memory over 60 geometries unlike scans; POINTS=30000 ONLY="helix,lattice"
	@$(MAKE) --no-print-directory -j$$(nproc) all tools
	@$(PYTHON) tests/bench/odd_geometries.py $(build) --points $(if $(filter command line,$(origin POINTS)),$(POINTS),30000) \
	    --only "$(ONLY)"

.PHONY: tools
tools: $(tool_programs) ## build the measuring programs of tests/

# ---------------------------------------------------------------------------------------------------- measuring
MODELS ?=
RATIOS ?=
chosen = $(if $(MODELS),--models '$(MODELS)') $(if $(RATIOS),--ratios '$(RATIOS)')

.PHONY: peers
peers: deps ## compare with CGAL, PCL, Open3D and meshoptimizer; MODELS=horse,venus RATIOS=0.2,0.1 -> out/peers.md
	@deploy/deps.sh $(peers_packages)
	@$(MAKE) --no-print-directory all $(peer_programs)
	@$(PYTHON) tests/peers/run.py --build $(build) $(chosen)

.PHONY: ablation
ablation: deps ## what the discrete shape operator is worth; MODELS= RATIOS= -> out/ablation.md
	@$(MAKE) --no-print-directory all
	@$(PYTHON) tests/peers/ablation.py --build $(build) $(chosen)

.PHONY: closed
closed: deps ## whether every closed model comes out closed, with all points; MODELS= RATIOS= -> out/closed.md
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@$(PYTHON) tests/peers/closed.py --build $(build) $(chosen)

.PHONY: placement
placement: deps ## whether placement=optimal is ever worse than subset, eleven ratios; MODELS= RATIOS= -> out/placement.md
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@$(PYTHON) tests/peers/placement.py --build $(build) $(chosen)

.PHONY: given
given: deps ## meshes with their own faces beside Lindstrom and Turk's; MODELS= RATIOS= JUDGE=cgal -> out/given.md
	@deploy/deps.sh libeigen3-dev libtbb-dev
	@$(MAKE) --no-print-directory -j$$(nproc) all $(addprefix $(build)/tests/peers/,surface_cgal distances)
	@$(PYTHON) tests/peers/given.py --build $(build) $(chosen) $(if $(JUDGE),--judge $(JUDGE))

.PHONY: from-points
from-points: deps ## closed models from points alone beside what knows the true mesh; MODELS= RATIOS= -> out/from_points.md
	@deploy/deps.sh libeigen3-dev libtbb-dev libmeshoptimizer-dev
	@$(MAKE) --no-print-directory -j$$(nproc) all $(addprefix $(build)/tests/peers/,surface_cgal meshoptimizer)
	@$(PYTHON) tests/peers/from_points.py --build $(build) $(chosen)

.PHONY: open-scans
open-scans: deps ## whether holes of scans stay open along their borders; MODELS= RATIOS= -> out/open_scans.md
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@$(PYTHON) tests/peers/open_scans.py --build $(build) $(chosen)

.PHONY: real-scans
real-scans: deps ## meshes of real scans beside the peers', with pictures; MODELS=lion RATIOS=0.1 SCANS="--no-halves"
	@deploy/deps.sh $(real_scans_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all \
	    $(addprefix $(build)/tests/peers/,surface_cgal soundness_cgal open3d)
	@$(PYTHON) tests/peers/real_scans.py --build $(build) $(chosen) $(SCANS)

.PHONY: paper
paper: deps ## Lee and Jong's evaluation again, with pictures; MODELS=horse,venus -> out/paper.html
	@deploy/deps.sh $(paper_packages)
	@$(MAKE) --no-print-directory all $(addprefix $(build)/tests/peers/,surface_cgal meshoptimizer)
	@$(PYTHON) tests/paper/run.py --build $(build) $(if $(MODELS),--models '$(MODELS)')

# ---------------------------------------------------------------------------------------------------- deployment
include deploy/deploy.mk

# ---------------------------------------------------------------------------------------------------- more tests
# Each unit test is a target, so that they run side by side, those that take longest first; what one prints is shown
# when it fails, and why it skipped.
long_units := $(foreach t,memory accuracy formats tiles database_faults delaunay pipeline denoise,$(filter %/test_$t,$(unit_programs)))
unit_runs := $(addprefix run-,$(long_units) $(filter-out $(long_units),$(unit_programs)))
fuzz_runs := $(addprefix run-,$(fuzz_programs))
$(fuzz_runs): seeds := $(wildcard tests/fuzz/seeds/* tests/fixtures/*/*/input.*)
$(filter %_http,$(fuzz_runs)): seeds := $(wildcard tests/fuzz/seeds/*)
.PHONY: test-unit $(unit_runs) $(fuzz_runs)
test-unit: $(unit_runs) $(fuzz_runs) ## the unit tests alone
$(unit_runs) $(fuzz_runs): run-%: %
	@$* $(seeds) > $*.log 2>&1 && echo "  OK $* $$(grep -c '^\[       OK' $*.log) tests" || { cat $*.log; exit 1; }
	@! grep -qE '^\[  SKIPPED \]|^skipped: ' $*.log || tests/unit/skipped.sh $*.log

# CGAL changes the way of rounding, which valgrind doesn't follow: what triangulates is left to the sanitizers.
valgrind_programs := $(filter-out %/test_delaunay %/test_cocone %/test_pipeline %/test_refine %/test_metro \
    %/test_denoise %/test_fixtures %/test_judge %/test_memory,$(unit_programs))
valgrind_runs := $(addprefix valgrind-,$(valgrind_programs))
.PHONY: valgrind $(valgrind_runs)
valgrind: all $(valgrind_programs) ## unit tests and service under valgrind: no invalid access, nothing lost
	@command -v valgrind > /dev/null || deploy/deps.sh valgrind
	@$(MAKE) --no-print-directory -j$$(nproc) $(valgrind_runs)
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -q -p no:cacheprovider tests/integration/valgrind.py
$(valgrind_runs): valgrind-%: %
	@valgrind -q --error-exitcode=9 --leak-check=full --show-leak-kinds=definite --errors-for-leak-kinds=definite $* \
	    > $*.valgrind 2>&1 && echo "  OK $* under valgrind" || { tail -60 $*.valgrind; exit 1; }

SCANS ?=
COUNT ?= 5000
.PHONY: test-mutations
test-mutations: all ## send COUNT=5000 mutated clouds, of SCANS too, to a service of its own
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) tests/integration/mutations.py --count $(COUNT) --seed $(SEED) $(SCANS)

# libFuzzer is there in config=fuzz alone; `make fuzz` goes there by itself.  What a run finds new stays in the corpus.
# Everywhere else the same targets run once on what the fuzzers begin with, as tests.
FUZZ_SECONDS ?= 20
CORPORA ?= $(abspath build/fuzz/tests/fuzz)
$(build)/tests/fuzz/fuzz_http: $(build)/tests/unit/folder.o
$(build)/tests/fuzz/fuzz_http: override LDFLAGS += -Wl,--wrap=log_line,--wrap=log_vline
$(fuzz_programs): override LDFLAGS += $(if $(filter fuzz,$(config)),-fsanitize=fuzzer)
$(fuzz_programs): $(build)/%: $(build)/%.o $(if $(filter fuzz,$(config)),,$(build)/tests/fuzz/replay.o) \
    $(libserver) $(libapi) $(libwhittle)
	$(say) LD $@
	$(Q)$(CC) $(LDFLAGS) -o $@ $(objects_first) -lcmocka $(API_LIBS) $(DAEMON_LIBS) $(CODEC_LIBS) -lexpat -lm

ifeq ($(config),fuzz)
.PHONY: fuzz
fuzz: $(fuzz_programs)
	@set -e; for f in $(fuzz_programs); do echo "== $$f"; corpus=$(CORPORA)/$${f##*/}.corpus; \
	    mkdir -p $$corpus $$f.seeds; \
	    for s in tests/fixtures/*/*/input.* tests/fuzz/seeds/*; do cp "$$s" "$$f.seeds/$$(echo "$$s" | tr / _)"; done; \
	    $$f -max_total_time=$(FUZZ_SECONDS) -timeout=60 -rss_limit_mb=2048 -print_final_stats=1 -verbosity=0 \
	        -artifact_prefix=$$f. $$corpus $$f.seeds; done
else
.PHONY: fuzz
fuzz: deps ## run each fuzzer for FUZZ_SECONDS=20; CORPORA=folder keeps what they find
	@deploy/deps.sh $(fuzz_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) config=fuzz fuzz
endif

# Everything of the contract, with what it wants of others: linters, a validating proxy and a client from npm, a
# browser, nginx, wget.
contract_tests := contract matrix description generated python_client javascript_client join batches attributes recipes browser clients prefix proxy clouds uploads \
                  formats levels preview cache idempotency webhooks access config cli memory
.PHONY: test-contract
test-contract: deps ## the whole contract, held by linters, a validating proxy, browser, proxies and clients of others -> out/clients.md
	@deploy/deps.sh $(contract_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all tests
	@cd tests/node && npm ci --no-audit --no-fund --ignore-scripts
	@failed=0; mkdir -p out; \
	WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -q -rs -n 2 -p no:cacheprovider --junitxml=out/contract.xml \
	    -o junit_logging=system-out $(contract_tests:%=tests/integration/test_%.py) || failed=1; \
	$(PYTHON) tests/tools/clients.py out/contract.xml && exit $$failed

reader_packages := cloudcompare pcl-tools python3-open3d assimp-utils $(if $(shell command -v npm),,nodejs npm)
.PHONY: readers
readers: deps ## what readers that aren't ours have of every format, PCL, CloudCompare, Open3D, three.js, loaders.gl ... -> out/readers.md
	@deploy/deps.sh $(reader_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@cd tests/node && npm ci --no-audit --no-fund --ignore-scripts
	@failed=0; mkdir -p out; \
	WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -q -rs -n 2 -p no:cacheprovider --junitxml=out/readers.xml \
	    -o junit_family=xunit1 tests/integration/test_attributes.py || failed=1; \
	$(PYTHON) tests/tools/readers.py out/readers.xml && exit $$failed

page_packages := chromium nginx-light openssl $(if $(shell command -v npm),,nodejs npm)
.PHONY: test-page
test-page: deps ## the page in a real browser: the whole way, also behind nginx with TLS; failures, keys, fingers, pixels, accessibility
	@deploy/deps.sh $(page_packages)
	@$(MAKE) --no-print-directory page
	@cd tests/page && npm ci --no-audit --no-fund --ignore-scripts
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -q -rs -p no:cacheprovider tests/integration/test_page.py \
	    tests/integration/test_page_states.py

.PHONY: compare-viewers
compare-viewers: deps ## from a file to what was lost: the page beside CloudCompare, Potree, a glTF viewer; pictures in out/viewers; CLOUD=scan.ply
	@deploy/deps.sh $(page_packages) cloudcompare xvfb xauth imagemagick
	@$(MAKE) --no-print-directory page
	@for f in tests/page tests/page/viewers; do (cd $$f && npm ci --no-audit --no-fund --ignore-scripts) || exit; done
	@mkdir -p out/viewers
	@[ -n '$(CLOUD)' ] || tests/demo/scan.sh armadillo out/armadillo.xyz
	@$(PYTHON) tests/page/compare.py $(build) out/viewers $(or $(CLOUD),out/armadillo.xyz)

# CLOUD is looked at first; while a job of LONG runs, that is.
.PHONY: screenshots
screenshots: deps ## pictures of every part of the page, dark and light, at three widths, in out/page; CLOUD=scan.ply LONG=larger.ply
	@deploy/deps.sh $(page_packages)
	@$(MAKE) --no-print-directory page
	@cd tests/page && npm ci --no-audit --no-fund --ignore-scripts
	@mkdir -p out/page
	@[ -n '$(CLOUD)' ] || tests/demo/scan.sh armadillo out/armadillo.xyz
	@$(PYTHON) tests/page/screenshots.py $(build) out/page $(or $(CLOUD),out/armadillo.xyz) $(LONG)

.PHONY: bench-page
bench-page: deps ## what a person waits for who opens a million points in a browser; BENCH="--points 2000000"
	@deploy/deps.sh $(page_packages)
	@$(MAKE) --no-print-directory page tools
	@cd tests/page && npm ci --no-audit --no-fund --ignore-scripts
	@$(PYTHON) tests/bench/page.py $(build) $(BENCH)

LOAD ?=
SECONDS ?= 3600
.PHONY: test-load
test-load: deps ## many clients at once, then many jobs; LOAD="--uploads 8 --bytes 8000000 --jobs 100"
	@$(MAKE) --no-print-directory all
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) tests/load/load.py $(LOAD)

.PHONY: test-soak
test-soak: deps ## mixed traffic with workers killed at random; nothing may grow; SECONDS=3600
	@$(MAKE) --no-print-directory all
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) tests/load/soak.py --seconds $(SECONDS) --seed $(SEED)

.PHONY: contract
contract: $(build)/whittled $(build)/tests/tools/tables ## bring api/openapi/ up to date with core/params.c and api/routes.def
	@$(PYTHON) tests/tools/update_contract.py $(build)

.PHONY: man
man: $(build)/man/whittle.1 $(build)/man/whittled.8 ## write the manual pages of both programs

$(build)/man/whittle.1: $(build)/whittle
$(build)/man/whittled.8: $(build)/whittled
$(build)/man/%:
	@mkdir -p $(@D)
	$(Q)$< --man > $@.tmp && mv $@.tmp $@

.PHONY: format
format: ## lay out the code with clang-format
	clang-format -i $(laid_out)

.PHONY: clean
clean: ## remove everything that was built
	rm -rf build out

-include $(shell find $(build) -name '*.d' -type f 2>/dev/null)
