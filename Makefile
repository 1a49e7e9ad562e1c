# The three commands of the README: `make demo`, `make panel` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STEPS ?= 1000000
# Bytecode is written when a module is first imported: pip would compile all that it installs.
unexport PYTHONDONTWRITEBYTECODE

# Robots and tests have the same versions.
LOCK := deploy/versions.txt

.PHONY: demo panel test long-test page-test vm vm-test vcan-test ros2-test check bench fleet fuzz soak mutants lock wheels clean

demo: $(VENV)/kernels
	$(BIN)/hyperbit demo

# The operator's page with simulated boards, until Ctrl-C.
panel: $(VENV)/kernels $(VENV)/panel
	$(BIN)/hyperbit run deploy/planar16.yaml --simulate --panel

# If one part fails, the other one still runs.
test: $(VENV)/test-kernels
	$(MAKE) --no-print-directory --keep-going --jobs 2 test-check test-run

.PHONY: test-check test-run
# Prints its report when it is done.
test-check: $(VENV)/installed
	report=$$(mktemp); code=0; \
	$(MAKE) --no-print-directory check > $$report 2>&1 || code=$$?; \
	cat $$report; rm $$report; exit $$code

# More processes than processors, because many tests wait. Tests in real time wait most, so that they run beside the others,
# which yield the processors to them. BLAS has no threads to gain by.
test-run: $(VENV)/installed
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --forks 5 --forks-beside 4 --durations 20 --ignore tests/browser -m "not long" $(ARGS)

# Kills, studies in several processes, notebooks, the wheel: LONG in tests/conftest.py.
long-test: $(VENV)/test-kernels
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --forks 3 --forks-beside 2 --durations 20 --ignore tests/browser -m long $(ARGS)

# Prepares the virtual machine, so that its tests begin at once.
vm: $(VENV)/installed
	$(BIN)/python -m tests.vm.prepare $(ARGS)

# Tests on the kernel's CAN and under systemd, in a virtual machine. The part for every check: make vm-test ARGS=--essential
# Some tests: make vm-test ARGS="tests/system -k reset"
vm-test: $(VENV)/installed
	$(BIN)/python -m tests.vm.boot $(ARGS)

# The tests of tests/system that need the kernel's CAN, in user-mode Linux, without root: make vcan-test ARGS="tests/system -k reset"
vcan-test: $(VENV)/installed
	$(BIN)/python -m tests.uml.boot $(ARGS)

# The operator's page in Debian's Chromium: apt-get install chromium chromium-driver
page-test: $(VENV)/kernels $(VENV)/page
	$(BIN)/pytest tests/browser $(ARGS)

# The wire of ROS 2 beside ROS 2's own Python packages, without rmw_zenoh, which has none. They need 540 MB, and Python 3.11.
# RViz's parser of robot descriptions: apt-get install liburdfdom-tools
ros2-test: $(VENV)/installed $(VENV)/ros2-jazzy/installed $(VENV)/ros2-kilted/installed
	$(BIN)/pytest tests/ros2/oracle $(ARGS)

$(VENV)/ros2-jazzy/installed: RCLPY := 7.1.6
$(VENV)/ros2-kilted/installed: RCLPY := 9.1.2
$(VENV)/ros2-%/installed:
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/pip install --quiet 'ros-rclpy[fastrtps]==$(RCLPY)' $(addprefix ros-,action-msgs diagnostic-msgs nav-msgs \
		rcl-interfaces sensor-msgs std-srvs test-msgs trajectory-msgs visualization-msgs) urdf-parser-py
	touch $@

check: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy tests/library/users_program.py
	rm -rf $(VENV)/linked
	cp -rsL $(CURDIR)/.package $(VENV)/linked
	PYTHONPATH=$(VENV)/linked $(BIN)/lint-imports

bench: $(VENV)/installed
	$(BIN)/python -m tests.benchmarks.search.growth
	$(BIN)/python -m tests.benchmarks.motion.trajectories
	$(BIN)/python -m tests.benchmarks.arm.shipped
	$(BIN)/python -m tests.benchmarks.search.poses
	$(BIN)/python -m tests.benchmarks.search.obstacles
	$(BIN)/python -m tests.benchmarks.motion.obstacle_transitions
	$(BIN)/python -m tests.benchmarks.daemon.goal_latency
	$(BIN)/python -m tests.benchmarks.daemon.real_time

# Twenty arms, five clients, two pages and a recorder on this computer, with faults. Two processors bear ten arms at most:
# make fleet ARGS="--arms 1,2,5,10"
fleet: $(VENV)/installed
	$(BIN)/python -m tests.benchmarks.fleet $(ARGS)

fuzz: $(VENV)/installed
	$(BIN)/python -m tests.fuzz $(ARGS)

# The executor, and the whole daemon, in simulated worlds with faults. A seed that fails is printed, see tests/README.md.
soak: $(VENV)/installed
	$(BIN)/python -m tests.simulation --steps $(STEPS)

# Random defects, planted one at a time: what finds them? make mutants ARGS="--seed 1 --sample 200 --with-tests --json FILE"
mutants: $(VENV)/installed
	PYTHONHASHSEED=0 nice $(BIN)/python -m tests.mutants $(ARGS)

# Updates the lock to the newest versions that pyproject.toml allows.
lock: $(VENV)/installed
	$(BIN)/pip install --quiet --upgrade --upgrade-strategy eager --editable '.[dev]'
	$(BIN)/python -m tests.deploy.versions

# A folder from which a robot without a network installs: install.sh and the wheels of all that the lock names. It is for
# computers as this one, or for others: make wheels ROBOT=aarch64 ROBOT_PYTHON=3.13
ROBOT := $(shell uname -m)
ROBOT_PYTHON := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
WHEELS := build/wheels-$(ROBOT)-$(ROBOT_PYTHON)
GLIBC := $(shell seq 17 36)  # of the robot, 2.17 to Debian 12's 2.36
wheels: $(VENV)/program
	rm -rf build/lib $(WHEELS)
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir $(WHEELS) .
	$(BIN)/pip download --quiet --no-deps --only-binary :all: --dest $(WHEELS) --python-version $(ROBOT_PYTHON) \
		$(GLIBC:%=--platform manylinux_2_%_$(ROBOT)) --platform manylinux2014_$(ROBOT) --requirement $(LOCK)
	cp deploy/install.sh $(LOCK) $(WHEELS)

# The program alone.
$(VENV)/program: pyproject.toml $(LOCK)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --constraint $(LOCK) --editable '.[pictures]'
	touch $@

# Machine code of the kernels, compiled on all processors. Without it the first start of the daemon compiles them on one.
$(VENV)/kernels: $(VENV)/program $(shell grep -rl @njit --include=*.py controller)
	$(BIN)/python -m hyperbit.controller.host.kernels
	touch $@

# The libraries of the page.
$(VENV)/panel: $(VENV)/program
	$(BIN)/pip install --quiet --constraint $(LOCK) --editable '.[panel,pictures]'
	touch $@

# And that of the tests' kernels. Without it each process of `make test` compiles them.
$(VENV)/test-kernels: $(VENV)/kernels $(shell grep -rl @njit --include=*.py tests/benchmarks)
	$(BIN)/python -m tests.kernels
	touch $@

# The developers' tools.
$(VENV)/installed: $(VENV)/program
	$(BIN)/pip install --quiet --constraint $(LOCK) --editable '.[dev]'
	touch $@

# And what drives the browser, and axe-core of npm, which looks at the page. Without npm the tests of axe are skipped.
AXE := 4.14.1
$(VENV)/page: $(VENV)/installed
	$(BIN)/pip install --quiet --constraint $(LOCK) --editable '.[dev,page]'
	-cd $(VENV) && npm pack --silent axe-core@$(AXE) && \
		tar -xzf axe-core-$(AXE).tgz --strip-components 1 package/axe.min.js && rm axe-core-$(AXE).tgz
	touch $@

clean:
	rm -rf $(VENV)
