# SPDX-License-Identifier: GPL-3.0-or-later
#
# Packages, images and releases; part of the Makefile.

# dpkg-buildpackage wants build-essential itself, whatever of it is there.
deb_packages := build-essential debhelper dpkg-dev bash-completion dh-python python3 xz-utils \
                $(if $(shell command -v npm),,nodejs npm)
deploy_packages := $(deb_packages) lintian mmdebstrap buildah umoci runc podman netavark iptables aardvark-dns catatonit \
                   docker-compose systemd systemd-container nginx-light openssl prometheus sqlite3 \
                   yamllint python3-yaml python3-kubernetes procps slurm-wlm munge \
                   $(if $(shell command -v kubectl),,kubernetes-client)

# ---------------------------------------------------------------------------------------------------- installing
PREFIX ?= /usr/local
DESTDIR ?=
LIBDIR ?= $(PREFIX)/lib
# Debian's Python looks for what isn't Debian's in a folder of its own version.
python_version = $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
PYTHONDIR ?= $(LIBDIR)/python$(if $(filter /usr/local,$(PREFIX)),$(python_version),3)/dist-packages
staged = $(DESTDIR)$(1)
# What programs that link libwhittle.a need beside it.
pc_private := $(filter-out -lstdc++,$(CORE_LIBS)) -lstdc++ -pthread

.PHONY: install-library
install-library: library ## libwhittle with its header, whittle.pc and Python module; PREFIX=/usr/local DESTDIR=
	install -d $(call staged,$(LIBDIR)/pkgconfig) $(call staged,$(PREFIX)/include)
	install -m644 $(libwhittle_so) $(whittle_a) $(call staged,$(LIBDIR))
	ln -sf $(SONAME) $(call staged,$(LIBDIR)/libwhittle.so)
	install -m644 core/whittle.h $(call staged,$(PREFIX)/include)
	sed -e 's|@PREFIX@|$(PREFIX)|; s|@LIBDIR@|$(LIBDIR)|; s|@VERSION@|$(VERSION)|; s|@PRIVATE@|$(pc_private)|' \
	    core/library/whittle.pc.in > $(call staged,$(LIBDIR)/pkgconfig/whittle.pc)
	install -d $(call staged,$(PYTHONDIR)/whittle)
	install -m644 api/python/whittle/*.py $(call staged,$(PYTHONDIR)/whittle)
	$(if $(DESTDIR),,$(if $(filter /usr /usr/local,$(PREFIX)),ldconfig)) # programs find a new library by its list

.PHONY: install
install: all man install-library ## programs, manual pages and library; PREFIX=/usr/local DESTDIR=
	install -d $(call staged,$(PREFIX)/bin) $(call staged,$(PREFIX)/share/man/man1) \
	    $(call staged,$(PREFIX)/share/man/man8) $(call staged,$(PREFIX)/share/bash-completion/completions) \
	    $(call staged,$(PREFIX)/share/zsh/vendor-completions) \
	    $(call staged,$(PREFIX)/share/fish/vendor_completions.d)
	install $(programs) $(call staged,$(PREFIX)/bin)
	install -m644 $(build)/man/whittle.1 $(call staged,$(PREFIX)/share/man/man1)
	install -m644 $(build)/man/whittled.8 $(call staged,$(PREFIX)/share/man/man8)
	install -m644 deploy/completion/bash/* $(call staged,$(PREFIX)/share/bash-completion/completions)
	install -m644 deploy/completion/zsh/* $(call staged,$(PREFIX)/share/zsh/vendor-completions)
	install -m644 deploy/completion/fish/* $(call staged,$(PREFIX)/share/fish/vendor_completions.d)

# ---------------------------------------------------------------------------------------------------- packages
.PHONY: print-packages
print-packages: # for those who keep a list of their own
	@echo $(packages)

.PHONY: print-deb-packages
print-deb-packages: # what making the Debian package wants beside them
	@echo $(deb_packages)

.PHONY: dist
dist: ## whittle-VERSION.tar.xz of the source in build/dist, the same bytes whenever it is made
	@deploy/dist.sh build/dist

.PHONY: deb
deb: deps ## the Debian package, in build/deb
	@deploy/deps.sh $(deb_packages)
	@deploy/deb.sh build/deb

IMAGE ?= whittle
.PHONY: image
image: ## the container image, with docker, podman or buildah; IMAGE=whittle
	@deploy/image.sh '$(IMAGE)'

.PHONY: sbom
sbom: all ## what the programs are linked with, as SPDX, in build/whittle.spdx.json
	@$(PYTHON) deploy/sbom.py $(programs) > build/whittle.spdx.json
	@echo build/whittle.spdx.json

.PHONY: test-deploy
test-deploy: deps ## image, package, fresh machine, proxy, Kubernetes, monitoring, Slurm: each made and run (root; 15 minutes)
	@deploy/deps.sh $(deploy_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -v -s -rs --durations=0 -p no:cacheprovider \
	    tests/deploy
