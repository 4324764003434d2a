"""Who belongs to a cohort, by folders, cohort.toml and people.csv."""

import json
from pathlib import Path

import pytest

from gaitcal.cohort.people import people_in, read_cohort, read_sheet, safe_name
from gaitcal.errors import InputError
from gaitcal.session.draft import settings_text


def put(*files: Path) -> None:
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two people, one of them with two sessions; a result, a hidden folder, and one without recordings."""
    here = tmp_path / "lab"
    put(here / "Ann" / "static.c3d", here / "Ann" / "walk.C3D", here / "Ann" / "raw" / "old.trc")
    for session in ("post", "pre"):
        put(here / "Bob" / session / "static.trc", here / "Bob" / session / "walk.trc")
    put(here / "notes" / "readme.txt", here / ".hidden" / "walk.c3d", here / "out" / "deep" / "walk.c3d")
    put(here / "earlier" / "walk.c3d")
    (here / "earlier" / "manifest.json").write_text(json.dumps({"gaitcal": "0.2.0"}))
    return here


def keys(path: Path, out: Path) -> list[tuple[str, str]]:
    return [person.key for person in read_cohort(path, out)[0].people]


def test_folders_are_people_and_complete_folders_in_them_sessions(folder: Path) -> None:
    cohort = people_in(folder, folder / "out")
    assert [p.key for p in cohort.people] == [("Ann", ""), ("Bob", "post"), ("Bob", "pre")]
    assert [p.place for p in cohort.people] == ["people/Ann", "people/Bob/post", "people/Bob/pre"]
    assert cohort.people[1].told.name == "Bob"  # not the session, which the folder is called
    assert cohort.ignored == ("notes",)


def test_folders_that_hold_parts_are_one_session(tmp_path: Path) -> None:
    put(
        tmp_path / "Cid" / "standing" / "static.c3d", tmp_path / "Cid" / "walks" / "a.c3d", tmp_path / "Cid/walks/b.c3d"
    )
    assert keys(tmp_path, tmp_path / "out") == [("Cid", "")]


def test_nobody_is_told(tmp_path: Path) -> None:
    put(tmp_path / "walk.c3d")
    with pytest.raises(InputError, match="recordings lie in the folder itself; no sub-folder holds recordings"):
        people_in(tmp_path, tmp_path / "out")


def test_people_csv_tells_what_no_file_does(folder: Path) -> None:
    lines = (
        "Person;session;group;sex;mass_kg;height_m;remarks",
        "Bob;;adults;m;70,5;1,8;x",
        "Bob;pre;adults;;71;;",
        "Zoe",
    )
    (folder / "people.csv").write_text("\ufeff" + "\n".join(lines), encoding="utf-8")
    people = {p.key: p for p in read_cohort(folder, folder / "out")[0].people}
    assert list(people) == [("Ann", ""), ("Bob", "post"), ("Bob", "pre"), ("Zoe", "")]
    post, pre = people["Bob", "post"], people["Bob", "pre"]
    assert (post.told.mass, post.told.height, post.told.sex, post.group) == (70.5, 1.8, "male", "adults")
    assert (pre.told.mass, pre.told.height) == (71.0, 1.8)
    assert not people["Zoe", ""].folder.exists()  # a failure of her own, later


def test_a_session_of_the_table_names_an_only_one(folder: Path) -> None:
    (folder / "people.csv").write_text("person,session\nAnn,2024-01-31\n", encoding="utf-8")
    assert keys(folder, folder / "out")[0] == ("Ann", "2024-01-31")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,mass_kg\nAnn,60\n", "found the columns name, mass_kg; allowed: person"),
        ("person,mass_kg\nAnn,heavy\n", "row 2: mass_kg: found 'heavy'; allowed: a number"),
        ("person,height_m\nAnn,1.7\nBob,175\n", "row 3: height_m: found 175"),
        ("person,sex\nAnn,x\n", "row 2: sex: found 'x'"),
        ("person,sex\n,m\n", "row 2: person: found nothing"),
        ("person,sex,Person\nAnn,m,Bob\n", "found 2 columns 'person'; allowed: one"),
        ("person,sex\nAnn,f\nAnn,m\n", "row 3: sex: found 'male', but row 2 says 'female' of the same person"),
        ("person,session,mass_kg\nAnn,a,60\nAnn,b,61\nAnn,a,62\n", "row 4: mass_kg: found 62, but row 2 says 60"),
        ("person,mass\nAnn,60\n", "found the column 'mass', which is not known; did you mean 'mass_kg'"),
        ("person,height\nAnn,1.7\n", "did you mean 'height_m'"),
        ("person,age\nAnn,17\n", "did you mean 'age_years'"),
        ("person,Weight\nAnn,60\n", "did you mean 'mass_kg'"),
        ("person,height_m\nAnn,1,75\n", "row 2: found more cells than columns; a decimal comma needs semicolons"),
    ],
)
def test_faults_of_the_table_are_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "people.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_sheet(tmp_path / "people.csv")


def test_other_columns_are_told_and_rows_may_repeat(folder: Path) -> None:
    text = "person,diagnosis,mass_kg,mass,sex,\nAnn,none,60,60,f,\nAnn,none,60,,w,\nBob,none,,,m,\n"
    (folder / "people.csv").write_text(text, encoding="utf-8")
    cohort = read_cohort(folder, folder / "out")[0]
    assert (cohort.people[0].told.mass, cohort.people[0].told.sex) == (60.0, "female")
    assert cohort.notes == ("people.csv: column 'diagnosis' is not used", "people.csv: column 'mass' is not used")


@pytest.mark.parametrize("row", ["/etc,", "../x,", ".,", "..,", "notes/deep,", "Cid,../x", "Cid,/etc"])
def test_a_table_leads_nowhere_else(folder: Path, row: str) -> None:
    (folder / "people.csv").write_text(f"person,session\n{row}\n", encoding="utf-8")
    with pytest.raises(InputError, match="allowed: the name of a folder, without a path") as caught:
        read_cohort(folder, folder / "out")
    assert "\n" not in str(caught.value)


def test_cohort_file_names_people_and_settings(folder: Path) -> None:
    file = folder / "cohort.toml"
    file.write_text(
        '[[person]]\nfolder = "Bob/pre"\nname = "Bob"\nsession = "pre"\nmass_kg = 70\n'
        '[[person]]\nfolder = "Ann"\n[calibration]\nip = "none"\n'
    )
    cohort, settings = read_cohort(folder, folder / "out")
    assert [p.key for p in cohort.people] == [("Ann", ""), ("Bob", "pre")]
    assert cohort.people[1].folder == (folder / "Bob" / "pre").resolve()
    assert settings_text(settings) == '\n[calibration]\nip = "none"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[person]]\nfolder = "A"\n[[person]]\nfolder = "x/A"\n', "found 'A' twice"),
        ('[[person]]\nfolder = "a"\n[[person]]\nfolder = "A"\n', "which one folder would hold"),
        ('[[person]]\nfolder = "A"\n[[person]]\nfolder = "A"\nsession = "pre"\n', "with a session and without one"),
        ('[[person]]\nfolder = "A"\nweight = 3\n', "weight"),
        ('[[person]]\nfolder = "A"\nsex = "m"\n', "sex"),
    ],
)
def test_faults_of_the_cohort_file_are_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "cohort.toml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_cohort(tmp_path / "cohort.toml", tmp_path / "out")


def test_names_become_folders_that_may_be() -> None:
    assert safe_name("P 01 (a)") == "P 01 (a)"
    assert safe_name("Jürgen") == "Jürgen"
    for name in ("../up", "a/b", "con", "x" * 200, ".hidden", "a:b", "\U00020000" * 70):
        safe = safe_name(name)
        assert safe != name
        assert not set('/\\:<>"|?*') & set(safe)
        assert len(safe.encode()) < 100
        assert not safe.startswith(".")
    assert safe_name("a/b") != safe_name("a:b")
