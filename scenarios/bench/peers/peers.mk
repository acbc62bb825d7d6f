# Environments of the controllers that `qpctrl bench --peers` measures beside ours.
PEERS ?= .peers

.PHONY: peers

peers: $(PEERS)/tsid/.installed $(PEERS)/placo/.installed ## build the peers' environments, some minutes

# A source package is built beside its pinned companions, whatever pip's age, and anew: the build
# that pip kept may have been made beside others, and crashes.
$(PEERS)/%/.installed: scenarios/bench/peers/%.txt
	$(PYTHON) -m venv --clear $(PEERS)/$*
	PIP_CONSTRAINT=$< PIP_BUILD_CONSTRAINT=$< PIP_NO_CACHE_DIR=1 CMEEL_RUN_TESTS=OFF \
		$(PEERS)/$*/bin/python -m pip install --quiet --requirement $<
	@touch $@

.PHONY: peers-humanoid

peers-humanoid: $(PEERS)/tsid/.installed ## add the humanoid of TSID's largest figure, 130 MB
	$(PEERS)/tsid/bin/python -m pip install --quiet --requirement scenarios/bench/peers/humanoid.txt
