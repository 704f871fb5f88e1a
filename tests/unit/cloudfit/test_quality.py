from cloudfit.quality import QUALITIES


def test_better_presets_work_harder_and_accept_less_error() -> None:
    draft, standard, reference = (QUALITIES[name] for name in ("draft", "standard", "reference"))
    for worse, better in ((draft, standard), (standard, reference)):
        assert worse.table_effort.paths < better.table_effort.paths
        assert worse.picture_effort.paths < better.picture_effort.paths
        assert worse.largest_image_error > better.largest_image_error
    assert standard.asymmetry_nodes == standard.extinction_nodes == 11
