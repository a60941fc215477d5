const char *core_sources(void);

/* CORE_SOURCES is given to the compiler. */
const char *core_sources(void)
{
    return CORE_SOURCES;
}
