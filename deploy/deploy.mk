# SPDX-License-Identifier: GPL-3.0-or-later
#
# Packages, images and releases; part of the Makefile.

deb_packages := debhelper dpkg-dev bash-completion xz-utils
deploy_packages := $(deb_packages) lintian mmdebstrap buildah umoci runc podman netavark aardvark-dns catatonit \
                   docker-compose systemd systemd-container nginx-light openssl prometheus sqlite3 \
                   yamllint python3-yaml python3-kubernetes procps \
                   $(if $(shell command -v kubectl),,kubernetes-client) $(if $(shell command -v npm),,nodejs npm)

.PHONY: print-packages
print-packages: # for those who keep a list of their own
	@echo $(packages)

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
test-deploy: deps ## image, package, fresh machine, proxy, Kubernetes, monitoring: each made and run (root; 15 minutes)
	@deploy/deps.sh $(deploy_packages)
	@$(MAKE) --no-print-directory -j$$(nproc) all
	@WHITTLE_BUILD=$(abspath $(build)) $(PYTHON) -m pytest -v -s -rs --durations=0 -p no:cacheprovider \
	    tests/deploy
