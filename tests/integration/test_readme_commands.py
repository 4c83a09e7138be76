"""Every command that a page shows is one that there is, and a test runs it with each option that the page shows."""

import json
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
import yaml

from friction_hil.cli import main
from friction_hil.errors import FrictionHilError
from tests.processes import run, simulated_drives, write_configuration
from tests.readme_commands import ROOT, resolve, shown_commands

LUGRE = "lugre:sigma0=2000,sigma1=1,coulomb=0.08,static=0.12,stribeck_velocity=0.2,damping_velocity=0.2"

# Run here, in this order, in one folder, with the exit statuses that are right.
WITHOUT_DRIVES = (
    ("friction-hil --help", 0),
    ("friction-hil --version", 0),
    ("friction-hil models", 0),
    ("friction-hil models lugre --draw lugre.png", 0),
    ("friction-hil config check machine.yaml", 0),
    ("friction-hil config show machine.yaml", 0),
    ("friction-hil config schema", 0),
    ("friction-hil doctor", 0),
    ("friction-hil explain FH-113", 0),
    ("friction-hil doctor machine.yaml --json", 0),
    ("friction-hil study --models coulomb --output study --json", 0),
    ("friction-hil study machine.yaml --output machine_study --json", 0),
    (
        f"friction-hil export {ROOT}/config/models/lugre_axis.yaml --to c --output axis_x.c --config machine.yaml "
        "--resolution 4.8e-5 --delay 0 --force",
        0,
    ),
    (f"friction-hil export {ROOT}/config/models/lugre_axis.yaml --to mjcf --speed 2", 0),
    ("friction-hil import lugre_axis_mjcf.xml --from mjcf --output imported.yaml", 0),
    ("friction-hil train --from-model coulomb:coulomb=0.1 --speed 1 --samples 1000 --hidden 2 --output net.yaml", 0),
)
WITH_DRIVES = (
    "friction-hil drives scan machine.yaml --json",
    "friction-hil drives show machine.yaml 1 --json",
    "friction-hil drives stop machine.yaml --json",
    "friction-hil stop machine.yaml --axis x --json",
    "friction-hil reset machine.yaml --axis x --json",
    "friction-hil run machine.yaml --pace sync --duration 3 --record run.mcap --json",
    "friction-hil run machine.yaml --pace sync --duration 0.2 --record listen.mcap --dry-run --reset-fault --force",
    "friction-hil run --simulate machine.yaml --pace sync --duration 0.2",
    "friction-hil latency machine.yaml --duration 0.1 --output latency.png",
    "friction-hil latency --period 0.0005 --spin 100 --priority 80 --duration 0.1 --json",
)
ON_THE_RECORDING = (
    ("friction-hil convert run.mcap run.csv", 0),
    ("friction-hil convert run.mcap run.csv --axis x --where is_fresh --force", 0),
    ("friction-hil convert --info run.csv --column torque=torque*1 --json", 0),
    ("friction-hil replay run.mcap --verify", 0),
    ("friction-hil health run.mcap --window 5 --report health.html", 1),  # too short to judge anything
    (f"friction-hil export {LUGRE} --to urdf --recording run.mcap --axis x --json", 0),
    (f"friction-hil replay 'run.*' --model {LUGRE} --json", 0),
    ("friction-hil fleet verify run.mcap --output fleet --json", 0),
    ("friction-hil plot run.mcap", 0),
    ("friction-hil plot run.mcap --output run.html --json", 0),
    ("friction-hil plot run.mcap --from 1 --to 2 --axis x", 0),
    ("friction-hil plot run.csv --config machine.yaml --column torque=torque*1 --output part.png", 0),
    (
        f"friction-hil replay run.csv --axis x --where is_fresh --model {LUGRE} --column position=position "
        "--column torque=torque --scale torque=1.0 --lowpass 100 --decimate 2 --output compared.png",
        0,
    ),
    (
        "friction-hil identify run.csv --models coulomb --column position=position --lowpass 100 --decimate 4 "
        "--gravity none --min-speed 0.01 --fix offset=0 --validate run.csv --loss huber --torque-is mean --no-refine "
        "--seed 1 --controller position_gain=20 --controller velocity_gain=0.05 --output axis.yaml --report axis.html",
        0,
    ),
)

# Run by other tests: command with options, and the test.
ELSEWHERE = (
    ("friction-hil demo --pace --json --output", "test_compensation_takes_the_friction_out_of_the_circle"),
    (
        "friction-hil simulate --pace --exit-with-stdin",
        "test_compensation_takes_the_friction_out_of_two_axes",
    ),
    ("friction-hil simulate --master", "test_compensation_beside_a_master_reduces_its_following_error"),
    ("friction-hil drives scan --bus", "test_scan_finds_the_nodes_and_writes_nothing"),
    ("friction-hil drives show --bus", "test_show_tells_units_mapping_watchdogs_and_the_way_of_the_compensation"),
    ("friction-hil drives stop --bus", "test_stop_says_that_another_master_is_there_and_stops_all_the_same"),
    ("friction-hil doctor --try-watchdog", "test_doctor_tries_the_watchdogs_of_simulated_drives"),
    ("friction-hil tune --output --json --yes --pace", "test_an_axis_learns_its_friction_on_its_drive"),
    ("friction-hil doctor --warm", "test_doctor_compiles_what_a_run_needs"),
    (
        "friction-hil tune --simulate --apply",
        "test_simulated_drives_are_tuned_and_the_model_of_the_machine_stays_as_it_is",
    ),
    ("friction-hil tune --mechanics", "test_an_axis_learns_its_friction_on_its_drive"),
    ("friction-hil tune --models --axis", "test_mistakes_are_reported_before_anything_moves"),
    ("friction-hil tune --reset-fault", "test_a_drive_in_fault_is_tuned_only_if_its_fault_may_be_reset"),
    (
        "friction-hil train --linear --column --structure --inputs",
        "test_a_residual_of_the_emps_axis_beats_the_physical_model_on_held_out_blocks",
    ),
    (
        "friction-hil train --output --report",
        "test_without_a_structure_the_network_is_kept_only_if_held_out_data_show_that_it_is_better",
    ),
    ("friction-hil train --from-model --report --json", "test_a_network_learns_a_model_and_runs_where_a_model_runs"),
    (
        "friction-hil health --report --metrics --history --json",
        "test_months_of_recordings_show_what_has_changed_and_nothing_else",
    ),
    (
        "friction-hil fleet --output --scheduler",
        "test_a_fleet_has_the_same_table_whoever_dies_and_goes_on_with_the_same_command",
    ),
    ("friction-hil fleet --to", "test_the_command_ends_with_the_worst_and_what_to_do_next"),
    ("friction-hil health --since --order", "test_after_a_repair_a_baseline_begins_again"),
    (
        "friction-hil health --fingerprint --simulate --pace --yes --axis --json",
        "test_a_fingerprint_is_a_motion_of_the_axis_that_is_kept_for_comparison",
    ),
    ("./tools/bench health --axes --json", "test_the_benchmark_of_health_has_every_change"),
    ("friction-hil identify --linear", "test_emps_published_parameters_to_the_printed_digits"),
    ("friction-hil identify --where --group-by --unknown-gain", "test_servo_has_friction_that_grows_with_its_load"),
    (
        "friction-hil identify --joints --torque --urdf --models --output",
        "test_identify_writes_a_model_file_of_each_joint_of_an_arm",
    ),
    (
        "friction-hil identify --velocity",
        "test_identify_reads_all_joints_of_a_wide_log_and_says_that_they_are_coupled",
    ),
    (
        "friction-hil identify --urdf-joints --signs",
        "test_names_and_signs_of_the_arm_s_joints_are_those_of_the_log",
    ),
    ("friction-hil identify --config", "test_a_log_gives_the_configuration_of_a_loop"),
    ("friction-hil identify --axis --column", "test_a_data_set_is_identified_joint_by_joint"),
    ("friction-hil identify --rate --column", "test_commands_take_a_rate_and_a_file_beside"),
    ("friction-hil convert --rate --column", "test_commands_take_a_rate_and_a_file_beside"),
    ("friction-hil replay --scheduler", "test_a_worker_that_is_killed_costs_no_bit"),
    ("friction-hil convert", "test_convert_writes_it"),
    (
        "friction-hil import --from --joint --output",
        "test_the_command_writes_a_model_file_and_names_what_is_missing",
    ),
    ("friction-hil config new --simulated --bus", "test_readmes_commands_in_their_order_in_an_empty_folder"),
    ("friction-hil config new --bus --node --torque --velocity --travel", "test_what_is_asked_for_is_in_the_file"),
    (
        "friction-hil config new --driver --description",
        "test_a_serial_drive_asks_for_what_its_description_needs",
    ),
    ("friction-hil config new --linear", "test_a_linear_axis_is_in_its_units"),
    ("friction-hil config new --mode", "test_a_simulated_drive_needs_nothing_else"),
    ("friction-hil config new --example", "test_an_example_is_listed_and_runs_from_where_it_is_copied_to"),
    (
        "friction-hil live --port --foxglove",
        "test_a_port_that_is_in_use_and_extras_that_are_missing_are_named_with_what_to_do",
    ),
    ("friction-hil models --library", "test_the_list_is_that_of_python"),
    ("friction-hil config new --like", "test_a_new_configuration_begins_with_the_friction_of_another_axis_and_says_so"),
    ("friction-hil models --beside", "test_the_command_draws_models_beside_each_other"),
    ("friction-hil models --motion", "test_the_command_draws_models_beside_each_other"),
    ("friction-hil models --export-all", "test_the_page_links_every_export_of_a_model"),
    ("friction-hil config examples", "test_an_example_is_listed_and_runs_from_where_it_is_copied_to"),
    ("friction-hil run --wait", "test_nothing_is_enabled_before_somebody_starts_it_and_again_after_a_stop"),
    ("friction-hil start", "test_nothing_is_enabled_before_somebody_starts_it_and_again_after_a_stop"),
    ("friction-hil set", "test_every_change_is_in_force_and_named"),
    ("friction-hil status --json", "test_status_shows_every_daemon"),
    ("friction-hil monitor --once --json", "test_the_monitor_shows_it"),
    ("friction-hil live", "test_foxglove_gets_the_rows_as_a_recording_has_them"),
    ("friction-hil service install", "test_the_command_says_what_it_wrote_and_what_comes_next"),
    ("friction-hil service status", "test_services_that_are_not_active_are_exit_status_1"),
    ("./tools/demo", "test_demo_hands_its_arguments_on"),
    ("./tools/test", "test_arguments_reach_pytest"),
    ("./tools/docs", "test_the_site_is_built_without_a_warning_and_has_every_page_and_message"),
    ("./tools/release", "test_a_development_version_is_not_released"),
    ("friction-hil explain", "test_a_code_is_explained"),
    ("./tools/mutants --only", "test_the_list_has_the_number_of_mutants_and_another_module_is_refused"),
    ("./tools/mutants --sample", "test_the_list_has_the_number_of_mutants_and_another_module_is_refused"),
    ("./tools/mutants --list", "test_the_list_has_the_number_of_mutants_and_another_module_is_refused"),
    ("./tools/campaign --output", "test_the_table_is_in_its_file_after_every_try"),
    ("./tools/campaign --list", "test_the_command_lists_faults_and_refuses_others"),
    ("./tools/bench", "test_no_benchmark_is_answered_with_what_there_is"),
    ("./tools/bench compensation --grid --json", "test_command_prints_one_json_object_and_tells_mistakes"),
    ("./tools/bench learning --only", "test_the_benchmark_of_learning_prints_one_json_object"),
    ("./tools/bench compensation --identified", "test_the_command_takes_machines_and_simulates_only_them"),
    ("./tools/bench models --json", "test_every_figure_of_the_benchmark_has_its_row"),
    ("./tools/bench recordings --json", "test_benchmark_of_recordings_has_every_format"),
    ("./tools/bench serial", "test_cycles_without_time_for_a_rehearsal_are_measured_all_the_same"),
    ("./tools/bench latency", "test_the_benchmark_of_latency_compares_sleeping_and_spinning"),
    ("./tools/bench dynamics", "test_the_benchmark_of_dynamics_compares_with_mujoco"),
    ("./tools/bench exchange", "test_the_benchmark_of_the_exchange_times_each_part"),
    ("./tools/bench own_loop", "test_the_benchmark_of_the_call_has_every_figure"),
    ("./tools/bench guiding --gain", "test_the_benchmark_of_guiding_prints_every_law"),
    ("./tools/bench tune --truth --by --only", "test_the_truth_helps_by_other_inputs_than_the_torque_too"),
    ("./tools/bench loop", "test_the_benchmark_of_the_loop_starts_a_daemon"),
    ("./tools/bench neural", "test_the_benchmark_of_networks_measures_an_iteration"),
)


def covered() -> Iterator[tuple[str, str]]:
    """Each command with each option that a test runs; a command without options has the option ''."""
    run_here = [text for text, _ in (*WITHOUT_DRIVES, *ON_THE_RECORDING)] + list(WITH_DRIVES)
    for text in run_here:
        name, options = resolve(tuple(shlex.split(text)))
        yield from ((name, option) for option in ("", *options))
    for text, _ in ELSEWHERE:
        name, *options = text.partition(" --")[0], *[word for word in text.split() if word.startswith("--")]
        yield from ((name, option) for option in ("", *options))


def test_each_command_on_a_page_is_one_that_there_is():
    wrong = []
    for shown in shown_commands():
        try:
            resolve(shown.words, is_complete=shown.is_complete)
        except (click.ClickException, FrictionHilError, AssertionError) as error:
            wrong.append(f"{shown}: {error}")
    assert not wrong, "\n".join(wrong)


def test_each_command_on_a_page_is_run_by_a_test():
    known = set(covered())
    missing = []
    for shown in shown_commands():
        name, options = resolve(shown.words, is_complete=False)
        missing += [f"{shown}: {name} {option}" for option in options or ("",) if (name, option) not in known]
    assert not missing, "run it here, or name the test that runs it:\n" + "\n".join(missing)


@pytest.mark.parametrize(("command", "name"), ELSEWHERE)
def test_a_test_that_is_named_is_there_and_uses_the_command_with_its_options(command, name):
    files = (path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    (text,) = [text for text in files if f"def {name}(" in text]
    helpers = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("*.py"))
    words = command.split()[1:] or [command.removeprefix("./tools/")]
    assert [word for word in words if word not in text + helpers] == []


def test_a_command_that_is_not_there_is_found(monkeypatch, tmp_path):
    page = tmp_path / "README.md"
    page.write_text("```sh\nfriction-hil run a.yaml --drations 5\n```\n")
    monkeypatch.setattr("tests.readme_commands.PAGES", [page])
    monkeypatch.setattr("tests.readme_commands.ROOT", tmp_path)
    with pytest.raises(AssertionError, match="--drations"):
        test_each_command_on_a_page_is_one_that_there_is()


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A folder with a configuration, ``machine.yaml``, of one simulated axis."""
    write_configuration(tmp_path).rename(tmp_path / "machine.yaml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def called(text: str) -> int:
    return main(shlex.split(text)[1:])


@pytest.mark.deep
def test_commands_that_need_no_drive(folder, capfd):
    pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")
    for text, status in WITHOUT_DRIVES:
        if text.startswith("friction-hil doctor"):  # it locks memory
            assert run(*shlex.split(text)[1:], check=False).returncode == status, text
        else:
            assert called(text) == status, f"{text}: {capfd.readouterr().err}"
    assert yaml.safe_load((folder / "net.yaml").read_text())["friction"]["model"] == "network"
    for made in ("lugre.png", "study/report.html"):
        assert (folder / made).stat().st_size > 10_000


@pytest.mark.deep
def test_commands_that_run_drives_and_look_at_the_recording(folder, capfd):
    pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")
    with simulated_drives(folder / "machine.yaml"):
        for text in WITH_DRIVES:
            assert run(*shlex.split(text)[1:]).returncode == 0
    for text, status in ON_THE_RECORDING:
        assert called(text) == status, f"{text}: {capfd.readouterr().err}"
    assert yaml.safe_load((folder / "axis.yaml").read_text())["friction"]["model"] == "coulomb"
    for made in ("compared.png", "axis.html", "run.png", "run.html", "part.png"):
        assert (folder / made).stat().st_size > 10_000


def test_doctor_tries_the_watchdogs_of_simulated_drives(folder):
    with simulated_drives(folder / "machine.yaml", pace="real"):
        done = run("doctor", "machine.yaml", "--try-watchdog", "--json")
    results = {one["check"]: one["result"] for one in json.loads(done.stdout)}
    tried = {name: result for name, result in results.items() if "heartbeat" in name or "RPDO" in name}
    assert len(tried) >= 2, results
    assert "fail" not in tried.values(), tried


@pytest.mark.deep
@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
@pytest.mark.parametrize("tool", ["demo", "bench"])
def test_the_tools_show_their_help(tool):
    done = subprocess.run([ROOT / "tools" / tool, "--help"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Usage: ")
